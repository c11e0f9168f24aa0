"""The causal detectors: one setting for every noise, a cone without a division, and no alarm that
stays for ever."""

from __future__ import annotations

from functools import cache

import numpy as np
import onnxruntime as ort
import pytest
from hard_marks import EVENTS, NORMAL
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.contract import BoolArray, FloatArray, Unit
from holdfast.edge_runtime.graph import open_session, run_recording, run_recordings
from holdfast.step.detectors import detector_names
from holdfast.step.features import feature_graph
from holdfast.step.spec import NOISE_RMS, DetectorSpec, StepSpec

RATE_HZ = 100.0
SENSORS = 2
RULES = DetectorSpec()
BURST_HZ = 20.0
LOUDER = (1.0, 10.0, 100.0)


@cache
def session_of(unit: Unit, rate_hz: float = RATE_HZ) -> ort.InferenceSession:
    return open_session(
        feature_graph(StepSpec(SENSORS, rate_hz, unit, ("now",))).SerializeToString()
    )


def detect(
    values: FloatArray,
    unit: Unit = "N",
    valid: BoolArray | None = None,
    rate_hz: float = RATE_HZ,
) -> dict[str, BoolArray]:
    """Detector name -> [T] whether it fires."""
    flags = np.ones((len(values), SENSORS), dtype=np.bool_) if valid is None else valid
    out = run_recording(session_of(unit, rate_hz), values, flags, ["detectors"])[
        "detectors"
    ]
    names = detector_names(StepSpec(SENSORS, rate_hz, unit, ("now",)))
    return {name: out[:, column] for column, name in enumerate(names)}


def quiet(
    seconds: float, unit: Unit = "N", seed: int = 0, rate_hz: float = RATE_HZ
) -> FloatArray:
    """Sensor noise and nothing else."""
    rng = np.random.default_rng(seed)
    return rng.normal(0.0, NOISE_RMS[unit], (round(seconds * rate_hz), 3 * SENSORS))


def at(seconds: float, rate_hz: float = RATE_HZ) -> int:
    return round(seconds * rate_hz)


def burst(
    values: FloatArray, start_s: float, lasts_s: float, size: float, channel: int = 0
) -> FloatArray:
    """The same stream with vibration on one channel."""
    rows = np.arange(at(start_s), at(start_s + lasts_s))
    shaken = values.copy()
    shaken[rows, channel] += size * np.sin(
        2 * np.pi * BURST_HZ * (rows - rows[0]) / RATE_HZ
    )
    return shaken


def long_streams() -> dict[str, FloatArray]:
    """Streams of 90 or 100 s, by name."""
    small = 40.0 * NOISE_RMS["N"]
    values = {f"{louder:g} times as noisy": quiet(90.0) for louder in LOUDER}
    for louder, name in zip(LOUDER, values, strict=True):
        values[name][:, 0] *= louder
        values[name] = burst(values[name], 85.0, 0.5, small * louder)
    loud, noise = quiet(90.0), quiet(100.0)
    loud[:, 0] *= 100.0
    noise[at(5.0) :, 3] *= 100.0
    values |= {
        f"burst on {k}": burst(loud, 85.0, 0.5, small, channel=k) for k in (0, 4)
    }
    return values | {"noise": noise, "tone": burst(quiet(100.0), 5.0, 95.0, 2.0)}


@cache
def band_pass() -> dict[str, BoolArray]:
    """Name of a long stream -> [T] whether the band-pass detector fires; all in one batch."""
    streams = long_streams()
    values = list(streams.values())
    valid = [np.ones((len(one), SENSORS), dtype=np.bool_) for one in values]
    rows = [np.arange(len(one)) for one in values]
    outputs = run_recordings(session_of("N"), values, valid, ["detectors"], rows)
    column = detector_names(StepSpec(SENSORS, RATE_HZ, "N", ("now",))).index(
        "band_pass"
    )
    return {
        name: out["detectors"][:, column]
        for name, out in zip(streams, outputs, strict=True)
    }


@given(seed=st.integers(0, 2**16), cut=st.integers(1, 299))
@settings(max_examples=10)
def test_later_samples_change_no_earlier_detection(seed: int, cut: int) -> None:
    values = burst(quiet(3.0, seed=seed), 1.0, 0.3, 1.0)
    later = values.copy()
    later[cut:] = 30.0 * quiet(3.0, seed=seed + 1)[cut:]
    other = detect(later)
    for name, detections in detect(values).items():
        np.testing.assert_array_equal(other[name][:cut], detections[:cut])


@pytest.mark.parametrize("unit", ["N", "uT", "count"])
def test_noise_alone_fires_nothing_in_any_unit(unit: Unit) -> None:
    assert not any(fired.any() for fired in detect(quiet(60.0, unit), unit).values())


@pytest.mark.parametrize("louder", LOUDER)
def test_one_setting_serves_a_channel_however_noisy_and_a_burst_still_fires(
    louder: float,
) -> None:
    fired = band_pass()[f"{louder:g} times as noisy"]
    assert not fired[at(60.0) : at(85.0)].any()
    assert fired[at(85.0) : at(85.5)].any()


def test_the_floor_is_each_channels_own() -> None:
    assert band_pass()["burst on 4"][at(85.0) : at(85.5)].any()
    assert not band_pass()["burst on 0"][at(85.0) : at(85.5)].any()


def test_vibration_along_the_normal_is_not_shear() -> None:
    assert not detect(burst(quiet(5.0), 3.0, 0.5, 2.0, channel=2))["band_pass"].any()


@EVENTS.mark
@pytest.mark.parametrize(
    ("kind", "begins_s", "ends_s"), [("noise", 6.0, 80.0), ("tone", 10.0, 90.0)]
)
def test_lasting_noise_or_a_lasting_tone_cannot_lock_the_alarm_on_for_ever(
    kind: str, begins_s: float, ends_s: float
) -> None:
    fired = band_pass()[kind]
    assert fired[at(5.5) : at(begins_s)].any()
    assert not fired[at(ends_s) :].any()


def test_a_burst_leaves_the_floor_almost_where_it_was() -> None:
    values = burst(quiet(20.0), 10.0, 0.5, 2.0)
    again = burst(values, 13.0, 0.5, 0.3)
    assert detect(again)["band_pass"][at(13.0) : at(13.6)].any()
    assert not detect(values)["band_pass"][at(12.5) :].any()


@given(
    bursts=st.lists(st.tuples(st.integers(0, 900), st.integers(1, 60)), max_size=10),
    seed=st.integers(0, 2**16),
)
@settings(max_examples=15)
def test_a_critical_point_is_the_first_sample_of_an_excursion_after_enough_quiet(
    bursts: list[tuple[int, int]], seed: int
) -> None:
    values = quiet(10.0, seed=seed)
    for start, length in bursts:
        values = burst(values, start / RATE_HZ, min(length, 999 - start) / RATE_HZ, 1.0)
    expect_points(values, RATE_HZ)


def expect_points(values: FloatArray, rate_hz: float) -> int:
    detections = detect(values, rate_hz=rate_hz)
    firing, points = detections["band_pass"], detections["band_pass_point"]
    needed = int(np.ceil(RULES.quiet_s * rate_hz - 1e-9))
    expected = [
        firing[row] and row >= needed and not firing[row - needed : row].any()
        for row in range(len(firing))
    ]
    np.testing.assert_array_equal(points, expected)
    return int(points.sum())


def test_quiet_that_is_exactly_long_enough_is_enough_and_one_sample_less_is_not() -> (
    None
):
    # noise alone makes excursions close together
    rules = DetectorSpec(quiet_s=0.05, band_ratio=1.5)
    spec = StepSpec(SENSORS, RATE_HZ, "N", ("now",), detectors=rules)
    session = open_session(feature_graph(spec).SerializeToString())
    values = quiet(30.0)
    valid = np.ones((len(values), SENSORS), dtype=np.bool_)
    firing, points, _ = run_recording(session, values, valid, ["detectors"])[
        "detectors"
    ].T
    change = np.diff(firing.astype(int))
    begins, ends = np.flatnonzero(change == 1) + 1, np.flatnonzero(change == -1) + 1
    begins = begins[begins > ends[0]]
    lasted = begins - ends[: len(begins)]
    assert {4, 5, 6} <= set(lasted.tolist())
    np.testing.assert_array_equal(points[begins], lasted >= 5)


def pressed(forces: FloatArray) -> FloatArray:
    """[T, C] long enough to have settled; the forces [K, C] are the last rows."""
    return np.concatenate([np.repeat(forces[:1], at(0.6), axis=0), forces])


@NORMAL.mark
@given(
    forces=st.lists(
        st.lists(
            st.sampled_from(
                [-3.0, -1.0, -0.4, 0.0, 0.3, 0.4, 0.5, 0.51, 0.8, 1.0, 5.0, 499.0]
            ),
            min_size=6,
            max_size=6,
        ),
        min_size=1,
        max_size=30,
    )
)
@settings(max_examples=20)
def test_the_cone_is_more_shear_than_friction_holds_at_some_finger_pressed_hard_enough(
    forces: list[list[float]],
) -> None:
    values = np.array(forces)
    detections = detect(pressed(values))["friction_cone"][-len(values) :]
    fingers = values.reshape(-1, SENSORS, 3)
    shear, normal = np.hypot(fingers[..., 0], fingers[..., 1]), fingers[..., 2]
    outside = (shear > RULES.friction * normal) & (normal > RULES.min_normal_n)
    on_the_edge = np.isclose(shear, RULES.friction * normal, rtol=1e-12).any(axis=1)
    np.testing.assert_array_equal(
        detections[~on_the_edge], outside.any(axis=1)[~on_the_edge]
    )


def test_a_finger_that_is_lost_or_not_settled_fires_nothing() -> None:
    forces = np.tile([5.0, 0.0, 1.0] * SENSORS, (120, 1))
    valid = np.ones((120, SENSORS), dtype=np.bool_)
    valid[90:92] = False
    cone = detect(forces, valid=valid)["friction_cone"]
    settled_after = 51
    expected = np.arange(120) >= settled_after - 1
    expected[90:92] = False
    np.testing.assert_array_equal(cone, expected)


@pytest.mark.parametrize("unit", ["uT", "count"])
def test_there_is_a_cone_only_where_forces_are_in_newton(unit: Unit) -> None:
    spec = StepSpec(SENSORS, RATE_HZ, unit, ("now",))
    assert "friction_cone" in detector_names(StepSpec(SENSORS, RATE_HZ, "N", ("now",)))
    assert "friction_cone" not in detector_names(spec)
    (output,) = [
        output
        for output in session_of(unit).get_outputs()
        if output.name == "detectors"
    ]
    assert output.shape[1] == len(detector_names(spec)) == 2
