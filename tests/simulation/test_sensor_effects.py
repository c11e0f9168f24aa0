"""Effects of the sensor: each obeys its formula, draws only from its own stream and leaves the rest
alone."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.contract import FloatArray, Unit
from holdfast.drivers.virtual.virtual_hand import FORCE_N_PER_UT
from holdfast.simulation.effects.effect import Signal, all_effects, stream
from holdfast.simulation.effects.magnet import calibrate, dipole_ut, linear_map, loads_n

MU0 = 4e-7 * np.pi
MOMENT_A_M2 = 1.35 / MU0 * np.pi * 0.75e-3**2 * 0.5e-3
"""Remanence / mu0 * volume, N45, 1.5 x 0.5 mm."""
SENSOR_EFFECTS = {n: e for n, e in all_effects().items() if e.stage == "sensor"}
NEUTRAL = {n: e.neutral for n, e in SENSOR_EFFECTS.items() if e.neutral is not None}
RATE_HZ = 100.0


def signal(values: FloatArray, unit: Unit = "uT") -> Signal:
    """[T, 6, 3] at 100 Hz, all valid."""
    return Signal(
        values,
        np.ones(values.shape[:2], dtype=np.bool_),
        unit,
        t_s=np.arange(len(values)) / RATE_HZ,
    )


def steady(
    rows: int = 300, vector: tuple[float, float, float] = (100.0, -200.0, 20e3)
) -> Signal:
    """The same field on all sensors, always."""
    return signal(np.tile(np.array(vector), (rows, 6, 1)))


def wandering(rows: int = 300) -> Signal:
    """Every channel different and never twice the same; about 20 mT in z."""
    rng = np.random.default_rng(1)
    return signal(rng.normal([0.0, 0.0, 2e4], [2e3, 2e3, 2e3], size=(rows, 6, 3)))


def forces(*each_n: Sequence[float] | FloatArray) -> Signal:
    """One row per force, the same on all six fingertips."""
    return signal(
        np.repeat(np.array(each_n, dtype=np.float64)[:, None], 6, axis=1), "N"
    )


def apply(name: str, to: Signal, seed: int = 7, **options: Any) -> Signal:
    """An effect as a card applies it; options: over its defaults."""
    effect = SENSOR_EFFECTS[name]
    drawn = effect.draw(options, stream(seed, 0, f"{name} parameters"))
    out = effect.sense(to, drawn, stream(seed, 0, name))
    assert isinstance(out, Signal)
    return out


def same(one: Signal, other: Signal) -> bool:
    """Equal to the bit."""
    for name in ("t_s", "values", "valid"):
        a, b = vars(one)[name], vars(other)[name]
        if a.dtype != b.dtype or a.shape != b.shape or a.tobytes() != b.tobytes():
            return False
    return one.unit == other.unit


def field_ut(z_m: float) -> float:
    """On the axis of a dipole (Jackson 1998, 5.56): mu0 m / (2 pi z^3)."""
    return float(1e6 * MU0 * MOMENT_A_M2 / (2.0 * np.pi * z_m**3))


# every effect


@pytest.mark.parametrize("name", NEUTRAL)
def test_an_effect_with_its_neutral_values_changes_no_bit(name: str) -> None:
    before = wandering()
    assert same(apply(name, before, **NEUTRAL[name]), before)


@pytest.mark.parametrize("name", SENSOR_EFFECTS)
def test_an_effect_changes_something_but_not_what_it_was_given(name: str) -> None:
    before = wandering()
    for array in (before.t_s, before.values, before.valid):
        array.setflags(write=False)
    after = apply(name, before, **SENSOR_EFFECTS[name].example)
    assert same(before, wandering())
    assert not same(after, before)
    assert after.valid.all()
    assert after.values.shape == (300, 6, 3)
    assert after.valid.shape == (300, 6)
    assert after.t_s.dtype == after.values.dtype == np.float64
    assert after.valid.dtype == np.bool_
    assert after.unit == "uT"


@pytest.mark.parametrize("name", SENSOR_EFFECTS)
def test_only_effects_that_draw_depend_on_the_seed(name: str) -> None:
    effect = SENSOR_EFFECTS[name]
    drawn = effect.draw(effect.example, stream(1, 0, name))
    rngs = [stream(seed, 0, name) for seed in (1, 2)]
    one, other = (effect.sense(wandering(), drawn, rng) for rng in rngs)
    fresh = stream(1, 0, name)
    drew = rngs[0].bit_generator.state != fresh.bit_generator.state
    assert same(one, other) == (not drew)


@pytest.mark.parametrize("name", SENSOR_EFFECTS)
def test_no_effect_makes_an_invalid_sample_valid(name: str) -> None:
    bad = replace(wandering(), valid=np.zeros((300, 6), dtype=np.bool_))
    assert not apply(name, bad, **SENSOR_EFFECTS[name].example).valid.any()


# dipole


@given(st.tuples(*[st.floats(-2e-3, 2e-3)] * 2), st.floats(1.5e-3, 5e-3))
def test_the_field_of_a_magnet_has_neither_sources_nor_curls(
    aside_m: tuple[float, float], z_m: float
) -> None:
    at = np.array([*aside_m, z_m])
    h = 1e-6
    slope = np.stack(
        [(dipole_ut(at + h * e) - dipole_ut(at - h * e)) / (2.0 * h) for e in np.eye(3)]
    )
    assert abs(np.trace(slope)) < 1e-5 * np.abs(slope).max()
    assert np.allclose(slope, slope.T, atol=1e-5 * np.abs(slope).max())


@pytest.mark.parametrize(
    ("force_n", "nearer_mm"),
    [(0.0, 0.0), (3.0, 1.0 / 11.0), (15.0, 1.0 / 3.0), (30.0, 0.5)],
)
@pytest.mark.parametrize("height_mm", [2.0, 10.0])
def test_a_press_brings_the_magnet_nearer_by_what_silicone_yields(
    height_mm: float, force_n: float, nearer_mm: float
) -> None:
    # F / (30 N/mm (1 + F / 30 N))
    read = apply("dipole", forces((0.0, 0.0, force_n)), height_mm=height_mm)
    assert read.values[0, :, 2] == pytest.approx(
        [field_ut(1e-3 * (height_mm - nearer_mm))] * 6, rel=1e-12
    )
    assert read.values[0, :, :2] == pytest.approx(0.0, abs=1e-9)


def test_shear_tilts_the_field_its_own_way() -> None:
    shear_n = 0.01 * np.array([[1, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    read = apply("dipole", forces(*shear_n)).values[:, 0]
    slope = 3.0 * field_ut(2e-3) / (2.0 * 2e-3)  # of 3 mu0/4pi m x / z^4
    expected = slope * shear_n[:, :2] / 15e3
    assert read[:, :2] == pytest.approx(expected, rel=1e-3, abs=1e-9)
    assert (read[:, 2] < field_ut(2e-3)).all()


# magnets in a soft pad

PAD: dict[str, Any] = {
    "rest_ut": 8000.0,
    "height_mm": 12.0,
    "normal_n_per_mm": 5.0,
    "shear_n_per_mm": 2.0,
}


def test_a_load_moves_the_magnet_of_a_pad_by_its_stiffness() -> None:
    read = apply("pad_magnet", forces([0, 0, 0], [0, 0, 0.1], [0.1, 0, 0]), **PAD)
    rest, pressed, sheared = read.values[:, 0]
    assert rest == pytest.approx([0.0, 0.0, 8000.0])
    assert read.unit == "uT"
    # Slopes of a dipole on its axis: 3 B / h inwards, 3 B / 2 h sideways.
    inwards = 3 * 8000 / 12 * 0.1 / 5
    sideways = 1.5 * 8000 / 12 * 0.1 / 2
    assert (pressed - rest)[2] == pytest.approx(inwards, rel=0.01)
    assert (sheared - rest)[0] == pytest.approx(sideways, rel=0.01)
    # However hard it is pressed, it stays above its chip.
    crushed = apply("pad_magnet", forces([0, 0, 1e4]), **PAD).values[0, 0, 2]
    assert crushed == pytest.approx(8000 / 0.2**3)


def test_a_magnetometer_has_the_noise_and_the_steps_of_its_set() -> None:
    read = apply("magnetometer", steady(4000)).values
    assert read.std(axis=(0, 1)) == pytest.approx([4.3, 4.3, 6.7], rel=0.03)
    steps = read / np.array([0.6, 0.6, 0.97])
    assert steps == pytest.approx(np.rint(steps), abs=1e-6)
    quiet = apply("magnetometer", steady(10), noise=0).values
    assert np.ptp(quiet, axis=0).max() == 0.0


# cross-talk


def test_a_neighbour_feels_a_magnet_by_the_cube_of_height_over_spacing() -> None:
    alone = np.zeros((1, 6, 3))
    alone[0, 2] = [100.0, -200.0, 20e3]
    after = apply(
        "cross_talk", signal(alone), height_mm=2, spacing_mm=10, axes=0
    ).values[0]
    assert after[1] == pytest.approx(0.008 * alone[0, 2], rel=1e-12)
    assert after[3] == pytest.approx(0.008 * alone[0, 2], rel=1e-12)
    assert np.array_equal(after[2], alone[0, 2])
    assert not after[[0, 4, 5]].any()


def test_an_axis_gets_its_share_of_the_other_two() -> None:
    after = apply(
        "cross_talk", steady(1, (10.0, 200.0, 3000.0)), height_mm=0, axes=0.1
    ).values[0]
    assert after == pytest.approx(np.tile([330.0, 501.0, 3021.0], (6, 1)), rel=1e-12)


# gain and tilt


def turns(seed: int, **options: Any) -> FloatArray:
    """[6, 3, 3] what becomes of a unit field along each axis; columns are images."""
    unit = signal(np.repeat(np.eye(3)[:, None], 6, axis=1))
    return apply("gain_tilt", unit, seed, **options).values.transpose(1, 2, 0)


def test_a_tilted_sensor_reads_the_same_strength_turned() -> None:
    turn = turns(7, gain_sd=0, tilt_sd_deg=20)
    assert turn @ turn.transpose(0, 2, 1) == pytest.approx(
        np.tile(np.eye(3), (6, 1, 1)), abs=1e-12
    )
    assert np.linalg.det(turn) == pytest.approx(np.ones(6))
    assert (np.abs(turn - np.eye(3)).max(axis=(1, 2)) > 1e-3).all()


def test_gains_and_angles_spread_as_they_say() -> None:
    drawn = [turns(seed, gain_sd=0.05, tilt_sd_deg=3) for seed in range(400)]
    image = np.concatenate(drawn)[:, :, 2]
    gain = np.linalg.norm(image, axis=1)
    x, y, z = image.T / gain
    about_x = np.degrees(np.arcsin(-y)) / 3.0
    about_y = np.degrees(np.arctan2(x, z)) / 3.0
    scaled = np.array([(gain - 1.0) / 0.05, about_x, about_y])
    # Four sigma of 2400 draws.
    assert scaled.std(axis=1) == pytest.approx(1.0, abs=0.06)
    assert np.abs(scaled.mean(axis=1)).max() < 0.08
    assert np.abs(np.corrcoef(scaled) - np.eye(3)).max() < 0.08


# magnets reversed


@given(st.lists(st.integers(1, 6), unique=True))
def test_reversed_magnets_turn_exactly_the_named_sensors(sensors: list[int]) -> None:
    before = wandering(3)
    after = apply("magnet_reversed", before, sensors=sensors)
    sign = np.ones((6, 1))
    sign[[number - 1 for number in sensors]] = -1.0
    assert np.array_equal(after.values, sign * before.values)


# warmth


def loss(**options: Any) -> FloatArray:
    """[T] the share of its field that a magnet lost; 300 rows a minute apart."""
    before = replace(steady(), t_s=60.0 * np.arange(300.0))
    kept = apply("thermal_drift", before, **options).values / before.values
    assert np.ptp(kept, axis=(1, 2)).max() < 1e-12
    share: FloatArray = 1.0 - kept[:, 0, 0]
    return share


def test_a_magnet_warms_as_a_body_of_first_order_and_loses_field_by_the_degree() -> (
    None
):
    share = loss(warming_degc=10, time_s=300, compensated=0)
    assert share[0] == 0.0
    assert share[-1] == pytest.approx(10 * 0.12e-2, rel=1e-9)
    left = 1.0 - share[:20] / share[-1]
    assert left[1:] / left[:-1] == pytest.approx(np.exp(-60.0 / 300.0))


def test_the_offset_of_each_axis_drifts_by_the_degree_and_not_the_field() -> None:
    t_s = 60.0 * np.arange(300.0)
    drifts = []
    for before in (steady(), steady(vector=(0.0, 0.0, 0.0))):
        options = {"warming_degc": 10, "time_s": 300, "offset_ut_per_degc": 3}
        after = apply("temperature", replace(before, t_s=t_s), **options)
        drifts.append(after.values - before.values)
    assert drifts[0] == pytest.approx(drifts[1], abs=1e-9)
    warm_degc = 10.0 * (1.0 - np.exp(-t_s / 300.0))
    per_degc = drifts[1][-1] / 10.0
    assert drifts[1] == pytest.approx(warm_degc[:, None, None] * per_degc, abs=1e-9)
    assert len(np.unique(per_degc)) == 18
    assert 1.5 < per_degc.std() < 5.0


# chip


def noise(seed: int = 7, **options: Any) -> FloatArray:
    """[20000, 18] uT"""
    still = signal(np.zeros((20_000, 6, 3)))
    return apply("hall_noise", still, seed, **options).values.reshape(-1, 18)


@pytest.mark.parametrize("averages", [32, 8, 1])
def test_noise_is_as_the_data_sheet_says_and_falls_with_the_root_of_averages(
    averages: int,
) -> None:
    sigma = np.tile([22.0, 22.0, 11.0], 6) * (32 / averages) ** 0.5
    # five sigma
    assert noise(averages=averages).std(axis=0) / sigma == pytest.approx(1.0, abs=0.025)


@given(
    st.integers(4, 24),
    st.tuples(st.floats(-40e3, 40e3), st.floats(-40e3, 40e3), st.floats(-80e3, 80e3)),
)
def test_a_reading_is_the_nearest_step_of_the_chip(
    bits: int, vector: tuple[float, float, float]
) -> None:
    before = steady(1, vector)
    after = apply("quantisation", before, bits=bits)
    step = np.array([80e3, 80e3, 160e3]) / 2.0**bits
    assert after.values / step == pytest.approx(np.round(after.values / step), abs=1e-9)
    assert (np.abs(after.values - before.values) <= step / 2.0 * (1.0 + 1e-9)).all()
    assert np.array_equal(apply("quantisation", after, bits=bits).values, after.values)


# clock and bus


@pytest.mark.parametrize("sd_ms", [0.3, 3, 20])
def test_samples_are_late_by_as_much_as_the_card_says_and_never_overtake(
    sd_ms: float,
) -> None:
    after = apply("timing_jitter", wandering(5000), sd_ms=sd_ms)
    late_s = after.t_s - np.arange(5000) / RATE_HZ
    assert np.diff(after.t_s).min() > 0.0
    assert np.abs(late_s).max() < 0.5 / RATE_HZ
    assert late_s[0] == late_s[-1] == 0.0
    # A wide spread is cut off, so that the order is kept.
    if sd_ms < 1.0:
        assert late_s.std() == pytest.approx(1e-3 * sd_ms, rel=0.05)
        assert abs(late_s.mean()) < 0.07e-3 * sd_ms


def test_a_late_sample_has_the_value_of_its_own_time() -> None:
    slope = np.arange(1.0, 19.0).reshape(6, 3)
    t_s = np.arange(500) / RATE_HZ
    after = apply("timing_jitter", signal(t_s[:, None, None] * slope), sd_ms=3)
    assert after.values == pytest.approx(after.t_s[:, None, None] * slope, abs=1e-12)
    assert np.abs(after.t_s - t_s).max() > 1e-3


# calibration


def newtons(*each_n: Sequence[float] | FloatArray) -> FloatArray:
    """[N, 3] of one sensor: pressed, read, calibrated and tared."""
    read = calibrate(apply("dipole", forces((0.0, 0.0, 0.0), *each_n)))
    tared_n: FloatArray = read.values[1:, 0] - read.values[0, 0]
    return tared_n


def residual_n(axes: slice) -> float:
    """RMS error of the map over the loads that it is fitted to; hardware: 0.12 N shear, 0.27 N."""
    return float(np.sqrt(np.mean((newtons(*loads_n()) - loads_n())[:, axes] ** 2)))


def test_the_rest_field_is_that_of_an_untouched_magnet_and_reads_23_n() -> None:
    assert linear_map()[1] == pytest.approx([0.0, 0.0, field_ut(2e-3)], rel=1e-12)
    assert calibrate(apply("dipole", forces((0.0, 0.0, 0.0)))).values[
        0, :, 2
    ] == pytest.approx([23.0] * 6, abs=1.0)


def test_a_virtual_hand_is_calibrated_as_the_scenes_sensors_are() -> None:
    assert linear_map()[0] == pytest.approx(FORCE_N_PER_UT, rel=1e-12, abs=1e-17)


@given(st.floats(0.0, 360.0), st.floats(0.0, 0.5), st.floats(1.0, 14.0))
def test_a_known_force_comes_back_on_its_side_within_three_residuals(
    angle_deg: float, share: float, normal_n: float
) -> None:
    angle = np.radians(angle_deg)
    shear = share * normal_n * np.array([np.cos(angle), np.sin(angle)])
    (back,) = newtons((float(shear[0]), float(shear[1]), normal_n))
    assert np.abs(back[:2] - shear).max() < 3.0 * residual_n(slice(2))
    assert abs(back[2] - normal_n) < 1.5 * residual_n(slice(2, 3))
    assert back[:2] @ shear >= -1e-9


def test_a_shear_gain_acts_along_the_skin_only() -> None:
    felt = apply("shear_gain", forces([1.0, -2.0, 5.0]), gain=0.6, spread=0.0)
    assert felt.values[0] == pytest.approx(np.tile([0.6, -1.2, 5.0], (6, 1)))


def test_a_mounted_sensor_turns_shear_about_its_normal_and_a_left_hand_mirrors() -> (
    None
):
    options: dict[str, Any] = {"angle_deg": 30.0, "spread_deg": 0.0}
    pull = forces([2.0, 0.0, 5.0])
    right = apply("mounting", pull, left_share=0.0, **options).values[0, 0]
    left = apply("mounting", pull, left_share=1.0, **options).values[0, 0]
    assert right == pytest.approx([np.sqrt(3.0), 1.0, 5.0])
    assert left == pytest.approx([-np.sqrt(3.0), -1.0, 5.0])
    spread = apply("mounting", pull, spread_deg=40.0).values[0]
    assert np.hypot(spread[:, 0], spread[:, 1]) == pytest.approx(np.full(6, 2.0))
    assert np.ptp(np.arctan2(spread[:, 1], spread[:, 0])) > 0.3


def test_play_lags_by_half_its_width_and_turns_only_after_all_of_it() -> None:
    there = np.linspace(0.0, 2.0, 41)
    back = np.linspace(2.0, 0.0, 41)
    path = np.concatenate([there, back])
    pushed = forces(*np.stack([path, path, path], axis=1))
    read = apply("hysteresis", pushed, width_n=0.4).values[:, 0, 2]
    assert read[40] == pytest.approx(1.8)
    # On the way back it stands still until the force has moved by the width.
    still = back >= 1.6 - 1e-9
    assert read[41:][still] == pytest.approx(np.full(still.sum(), 1.8))
    assert read[-1] == pytest.approx(0.2)


def test_drift_grows_evenly_and_steps_once() -> None:
    rest = signal(np.zeros((1001, 6, 3)), "N")
    read = apply("drift", rest, rate_n_s=0.02, step_n=0.5, step_at_s=4.0).values
    moves = np.diff(read, axis=0)
    step = moves[399]
    others = np.delete(moves, 399, axis=0)
    assert np.ptp(others, axis=0).max() < 1e-12
    assert np.abs(others[0]).max() * RATE_HZ <= 0.02
    assert np.abs(others[0]).max() * RATE_HZ > 0.01
    assert 0.25 < np.abs(step).max() <= 0.5 + 0.02 / RATE_HZ


@pytest.mark.parametrize("rms_n", [0.003, 0.04])
def test_white_noise_has_its_size(rms_n: float) -> None:
    rest = signal(np.zeros((4000, 6, 3)), "N")
    noise = apply("white_noise", rest, rms_n=rms_n).values.reshape(4000, 18)
    assert noise.std(axis=0) == pytest.approx(np.full(18, rms_n), rel=0.05)


def test_by_chance_each_magnet_is_upside_down_as_often_as_the_card_says() -> None:
    field = steady(1)
    turned = np.array(
        [
            np.sign(
                apply("magnet_reversed", field, seed, sensors=[3], share=0.3).values
                / field.values
            )[0, :, 2]
            for seed in range(600)
        ]
    )
    assert (turned[:, 2] == -1.0).all()
    others = np.delete(turned, 2, axis=1) < 0.0
    assert others.mean(axis=0) == pytest.approx(np.full(5, 0.3), abs=0.06)
