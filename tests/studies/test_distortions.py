"""Distortions: each obeys its law exactly, and a loop meets the same one as a recording."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from benchmarks.paired import paired_change
from holdfast.core.contract import FloatArray
from holdfast.core.hand_card import Side
from holdfast.simulation.loop.sensing import LoopSensors
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from studies.distortions.chain import (
    CrossTalk,
    Drift,
    Hysteresis,
    Noise,
    OffsetStep,
    Quantisation,
    Scaling,
    Smoothing,
)
from studies.distortions.closed_loop import BetweenByName
from studies.distortions.fingers import DeadFingers, FewerFingers
from studies.distortions.geometry import AxesRotation, HandRotation, Tilt
from studies.distortions.law import Law, PlanRequest, distorted
from studies.distortions.quiet_hand import QuietHand
from studies.distortions.table import DISTORTIONS, TRIALS, by_name
from studies.distortions.trials import FeltSet, FeltTrial, readings_of

SAMPLES, SENSORS, THUMB, RATE_HZ = 450, 6, 2, 150.0
SIDES: tuple[Side, ...] = tuple(
    "thumb" if k < THUMB else "opposing" for k in range(SENSORS)
)
AT_REST: list[Law] = [
    HandRotation(0.0),
    AxesRotation(0.0),
    Tilt(0.0, "x"),
    Scaling(),
    Noise(0.0),
    OffsetStep(0.0),
    Drift(0.0),
    CrossTalk(0.0),
    Smoothing(0.0),
    Hysteresis(0.0),
    DeadFingers(0, "noise"),
]
"""Every law at the size at which it does nothing."""
LAWS = [one for one in DISTORTIONS if one.law is not None]


def readings(seed: int = 0) -> FloatArray:
    """[T, S, 3] readings that wander, N."""
    rng = np.random.default_rng(seed)
    steps = 0.05 * rng.normal(size=(SAMPLES, SENSORS, 3))
    wandering: FloatArray = steps.cumsum(axis=0)
    return wandering


def after(law: Law, values: FloatArray, seed: int = 1) -> tuple[FloatArray, Any]:
    """(values, valid) after a law, with its draws from a seed."""
    t_s = np.arange(len(values)) / RATE_HZ
    request = PlanRequest(np.random.default_rng(seed), t_s, SIDES)
    return distorted(law, values, np.ones(values.shape[:2], dtype=np.bool_), request)


@pytest.mark.parametrize("law", AT_REST, ids=repr)
def test_a_distortion_of_size_zero_changes_nothing(law: Law) -> None:
    values = readings()
    made, valid = after(law, values)
    np.testing.assert_allclose(made, values, rtol=0, atol=1e-15)
    assert valid.all()


@given(degrees=st.floats(-360.0, 360.0), seed=st.integers(0, 9))
@settings(max_examples=25, deadline=None)
def test_a_turn_and_its_inverse_leave_the_readings(degrees: float, seed: int) -> None:
    values = readings(seed)
    for there, back in (
        (HandRotation(degrees), HandRotation(-degrees)),
        (AxesRotation(degrees), AxesRotation(-degrees)),
        (Tilt(degrees, "y"), Tilt(-degrees, "y")),
    ):
        turned, _ = after(there, values)
        returned, _ = after(back, turned)
        np.testing.assert_allclose(returned, values, rtol=0, atol=1e-12)
        lengths = np.linalg.norm(turned, axis=2)
        np.testing.assert_allclose(lengths, np.linalg.norm(values, axis=2), atol=1e-12)


def test_the_hand_turned_takes_the_thumb_the_other_way() -> None:
    """A load along the fingers' x is along y after a quarter turn, with the thumb's other sign."""
    values = np.zeros((1, SENSORS, 3))
    values[..., 0] = 1.0
    made, _ = after(HandRotation(90.0), np.repeat(values, 2, axis=0))
    np.testing.assert_allclose(made[0, :THUMB, 1], -1.0)
    np.testing.assert_allclose(made[0, THUMB:, 1], 1.0)
    alike, _ = after(AxesRotation(90.0), np.repeat(values, 2, axis=0))
    np.testing.assert_allclose(alike[0, :, 1], 1.0)


@pytest.mark.parametrize("bits", [8, 12, 16])
def test_quantised_readings_are_whole_steps_and_at_most_half_a_step_off(
    bits: int,
) -> None:
    law = Quantisation(bits)
    made, _ = after(law, readings())
    steps = made / law.step_n
    np.testing.assert_allclose(steps, np.rint(steps), atol=1e-9)
    assert np.abs(made - readings()).max() <= 0.5 * law.step_n * (1 + 1e-9)
    again, _ = after(law, made)
    np.testing.assert_array_equal(again, made)


def test_noise_drift_and_offset_are_as_large_as_they_say() -> None:
    nothing = np.zeros((SAMPLES, SENSORS, 3))
    noise, _ = after(Noise(0.05), nothing)
    assert noise.std() == pytest.approx(0.05, rel=0.03)
    drift, _ = after(Drift(0.02), nothing)
    np.testing.assert_allclose(np.abs(drift[-1]), 0.02 * (SAMPLES - 1) / RATE_HZ)
    step, _ = after(OffsetStep(0.3), nothing)
    assert not step[:200].any()
    np.testing.assert_allclose(np.abs(step[-1]), 0.3)


def test_a_smoothed_step_has_risen_by_63_percent_after_its_time() -> None:
    values = np.zeros((SAMPLES, SENSORS, 3))
    values[10:] = 1.0
    # 30 samples at 150 Hz
    made, _ = after(Smoothing(200.0), values)
    assert made[39, 0, 0] == pytest.approx(1.0 - np.exp(-1.0))
    assert not made[:10].any()


def test_hysteresis_is_never_more_than_half_its_width_off_and_ignores_less() -> None:
    values = readings()
    made, _ = after(Hysteresis(0.3), values)
    assert np.abs(made - values).max() <= 0.15 + 1e-12
    small = 0.1 * np.sin(np.arange(SAMPLES))[:, None, None] * np.ones((1, SENSORS, 3))
    still, _ = after(Hysteresis(0.3), small)
    np.testing.assert_array_equal(still, np.broadcast_to(small[:1], small.shape))


@pytest.mark.parametrize("fault", ["invalid", "last value", "noise"])
def test_dead_fingers_stand_still_or_are_marked_and_the_others_stay(
    fault: Any,
) -> None:
    values = readings()
    made, valid = after(DeadFingers(2, fault), values)
    changed = (made != values).any(axis=(0, 2))
    assert changed.sum() == 2
    assert valid[:200].all()
    assert (~valid).any(axis=0).sum() == (2 if fault == "invalid" else 0)
    if fault != "noise":
        assert not np.diff(made[-50:, changed], axis=0).any()


def test_fewer_fingers_bear_what_all_of_their_side_bore() -> None:
    values = readings()
    made, _ = after(FewerFingers((0, 2, 3)), values)
    for side in (slice(0, THUMB), slice(THUMB, SENSORS)):
        np.testing.assert_allclose(
            made[:, side].sum(axis=1), values[:, side].sum(axis=1), atol=1e-12
        )
    assert not made[:, [1, 4, 5]].any()
    everyone, _ = after(FewerFingers(tuple(range(SENSORS))), values)
    np.testing.assert_allclose(everyone.sum(axis=1), values.sum(axis=1), atol=1e-12)


@pytest.fixture(scope="module")
def scene() -> Scene:
    return Scene(read_scene_file(str(TRIALS)), 100)


@pytest.mark.parametrize("name", [one.name for one in LAWS])
def test_a_loop_meets_the_very_readings_of_the_recording(
    name: str, scene: Scene
) -> None:
    distortion = by_name()[name]
    # Two pulls of other lengths.
    trials = [one for one in scene.trials(12) if one.action == "pull"][:2]
    # Faults begin at 2.6 s at the latest.
    counts = np.array([420, 400])
    forces_n = np.abs(readings()[:420, None]) + np.array([0.0, 0.5])[:, None, None]
    sensors = LoopSensors(scene, trials, counts)
    reader = BetweenByName(name)(sensors, trials, counts)

    in_loop = []
    for k in range(420):
        rows = np.minimum(k, counts - 1)
        now = reader.read(rows, forces_n[rows, np.arange(2)])
        in_loop.append(now)
    of = FeltSet(scene, ())
    truth: Any = None
    for place, trial in enumerate(trials):
        n = counts[place]
        felt = FeltTrial(trial, np.arange(n) / RATE_HZ, forces_n[:n, place], truth)
        values, valid = readings_of(of, felt, distortion)
        looped = np.array([row.values[place] for row in in_loop[:n]])
        np.testing.assert_allclose(looped, values, rtol=0, atol=1e-12)
        looped_valid = np.array([row.valid[place] for row in in_loop[:n]])
        np.testing.assert_array_equal(looped_valid, valid)


def test_the_quiet_hand_has_the_noise_and_the_drift_of_its_row() -> None:
    still = QuietHand(3.0).readings(100, 0, RATE_HZ, 2)
    assert still.shape == (9000, 2, 3)
    np.testing.assert_allclose(still.std(axis=0), 0.003, rtol=0.05)
    drifts = QuietHand(0.0, 0.02).readings(100, 0, RATE_HZ, 2)
    np.testing.assert_allclose(np.abs(drifts[-1] - drifts[0]), 0.02 * 8999 / RATE_HZ)


def test_a_paired_change_counts_what_changed_and_is_never_too_narrow() -> None:
    before = {str(k): k < 80 for k in range(100)}
    now = {str(k): k < 60 for k in range(100)}
    change, interval = paired_change(now, before)
    assert change == pytest.approx(-0.2)
    assert interval is not None
    assert interval[0] < -0.2 < interval[1] < 0.0
    same, around = paired_change(before, before)
    assert same == 0.0
    assert around is not None
    assert around[0] < 0.0 < around[1]
    assert paired_change({}, before) == (None, None)
