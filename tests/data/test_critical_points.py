"""Offline critical points: the laws of the filter bank, the friction cone, and the rules in
seconds."""

from __future__ import annotations

import numpy as np
import pytest
from hard_marks import BAD_SAMPLE, COLLAR, DEGENERATE, NORMAL, SIGN
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.contract import FloatArray
from holdfast.data.critical_points import friction_rows, offline_critical_points
from holdfast.data.recording import Recording

RATES_HZ = (50.0, 100.0, 150.0, 300.0)
GRASP_S, SLIP_S = 3.0, 6.0


def held_object(
    rate_hz: float = 50.0, seed: int = 0, slip_s: float = SLIP_S
) -> FloatArray:
    """[T, 6]: two sensors close on something at 3 s, feel it shake and shift at `slip_s`; 9 s in
    all."""
    rng = np.random.default_rng(seed)
    t_s = np.arange(round(9.0 * rate_hz)) / rate_hz
    since_s = t_s - slip_s
    grip = 2.0 * np.clip((t_s - GRASP_S) / 0.1, 0.0, 1.0)
    shift = 0.8 * np.clip(since_s / 0.1, 0.0, 1.0)
    shakes = (since_s >= 0.0) & (since_s < 0.2)
    burst = shakes * 0.5 * np.sin(2 * np.pi * 15.0 * since_s)
    x = 0.4 * grip + shift + burst
    clean = np.stack([x, 0.2 * x, grip, 0.5 * x, -x, 1.2 * grip], axis=1)
    return clean + rng.normal(0.0, 0.005, clean.shape)


def recording(samples: FloatArray, rate_hz: float = 50.0) -> Recording:
    valid = np.ones((len(samples), samples.shape[1] // 3), dtype=np.bool_)
    return Recording("trial", "trial", samples, valid, rate_hz, "N")


def rows(samples: FloatArray, rate_hz: float = 50.0) -> list[int]:
    return [point.row for point in offline_critical_points(recording(samples, rate_hz))]


@pytest.mark.parametrize("rate_hz", RATES_HZ)
def test_the_grasp_and_the_slip_are_found_at_every_rate_and_nothing_else(
    rate_hz: float,
) -> None:
    points = offline_critical_points(recording(held_object(rate_hz), rate_hz))
    assert [point.t_s for point in points] == pytest.approx([GRASP_S, SLIP_S], abs=0.12)
    assert all(point.t_s == point.row / rate_hz for point in points)


@given(
    offset=st.lists(st.floats(-50.0, 50.0), min_size=6, max_size=6),
    factor=st.floats(1e-3, 1e3),
    seed=st.integers(0, 50),
)
@settings(max_examples=30)
def test_a_constant_offset_and_the_unit_of_the_channels_change_nothing(
    offset: list[float], factor: float, seed: int
) -> None:
    samples = held_object(seed=seed)
    assert rows(factor * (samples + np.array(offset))) == rows(samples)


@given(order=st.permutations(range(4)), seed=st.integers(0, 50))
@settings(max_examples=20)
def test_the_order_of_the_sensors_changes_nothing(order: list[int], seed: int) -> None:
    later = held_object(seed=seed + 1, slip_s=7.0)
    samples = np.hstack([held_object(seed=seed), later])
    by_sensor = samples.reshape(len(samples), 4, 3)
    assert rows(by_sensor[:, order].reshape(samples.shape)) == rows(samples)


@SIGN.mark
@given(
    mirror=st.lists(st.sampled_from([-1.0, 1.0]), min_size=4, max_size=4),
    seed=st.integers(0, 50),
)
@settings(max_examples=20)
def test_the_sign_of_a_shear_axis_changes_nothing(
    mirror: list[float], seed: int
) -> None:
    samples = held_object(seed=seed)
    signs = np.array([*mirror[:2], 1.0, *mirror[2:], 1.0])
    assert rows(samples * signs) == rows(samples)


@given(
    seed=st.integers(0, 1000),
    rate_hz=st.sampled_from(RATES_HZ),
    slip_s=st.floats(0.0, 9.0),
)
@settings(max_examples=30)
def test_points_keep_off_both_ends_and_apart_from_each_other(
    seed: int, rate_hz: float, slip_s: float
) -> None:
    points = offline_critical_points(
        recording(held_object(rate_hz, seed, slip_s), rate_hz)
    )
    times = np.array([point.t_s for point in points])
    assert np.all((times >= 1.0) & (times < 8.0))
    assert np.all(np.diff(times) > 0.5)


@NORMAL.mark
def test_a_normal_force_that_crosses_zero_makes_no_friction_point() -> None:
    rng = np.random.default_rng(0)
    t_s = np.arange(500) / 50.0
    samples = rng.normal(0.0, 0.01, (500, 3))
    # steady shear; the quotient x / z has a pole wherever z passes through zero
    samples[:, 0] += 1.0
    samples[:, 2] += np.sin(2 * np.pi * 0.3 * t_s)
    assert not friction_rows(samples, 50.0).size


@COLLAR.mark
def test_of_two_jumps_within_half_a_second_the_larger_is_kept() -> None:
    t_s = np.arange(500) / 50.0
    samples = np.random.default_rng(0).normal(0.0, 0.002, (500, 3))
    samples[:, 2] += 2.0 * (t_s >= 2.0)
    for jump_s, size in ((5.0, 0.5), (5.3, 1.0), (7.0, 1.0), (7.3, 0.5)):
        samples[:, 0] += size * (t_s >= jump_s)
    assert friction_rows(samples, 50.0)[-2:] == pytest.approx([265, 350], abs=1)


@DEGENERATE.mark
def test_a_dead_or_silent_recording_has_no_points() -> None:
    assert rows(np.zeros((500, 6))) == []
    assert rows(np.full((500, 6), np.nan)) == []


@BAD_SAMPLE.mark
def test_lost_values_poison_nothing() -> None:
    samples = held_object()
    expected = rows(samples)
    bad = np.array([np.nan, np.inf, -np.inf, np.nan, 1e30])
    samples[[0, 20, 21, 200, 201], :3] = bad[:, None]
    trial = recording(samples)
    trial.valid[201, 0] = False
    assert [point.row for point in offline_critical_points(trial)] == expected


def test_an_invalid_sensor_is_not_believed() -> None:
    trial = recording(held_object())

    def has_a_point_there() -> bool:
        return any(240 <= one.row < 260 for one in offline_critical_points(trial))

    trial.samples[250:255, :3] += 100.0
    assert has_a_point_there()
    trial.valid[250:255, 0] = False
    assert not has_a_point_there()
