"""The drive of a hand: its lag, speed, ceiling and backlash, and that nothing drives it back."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.contract import FloatArray
from holdfast.simulation.loop.drive import Actuator, Drive
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file

DT_S = 1e-3
LIVELY = [
    t for t in Scene(read_scene_file("thesis"), 0).trials(8) if t.action != "nothing"
]


def grips(
    actuator: Actuator, target_n: FloatArray | float, lasts_s: float = 1.0
) -> FloatArray:
    """[K, B] grips of a drive with one target."""
    target = np.broadcast_to(
        np.asarray(target_n, dtype=np.float64), actuator.own_n.shape
    )
    return np.array(
        [actuator.step(target, DT_S).copy() for _ in range(round(lasts_s / DT_S))]
    )


def drive_of(trials: list[PlannedTrial] = LIVELY, **changes: float) -> Actuator:
    return Actuator(Drive(**changes), trials)


@settings(max_examples=30)
@given(
    lag_ms=st.sampled_from([0.0, 20.0, 50.0, 100.0]),
    targets=st.lists(st.floats(0.0, 1e6), min_size=1, max_size=30),
)
def test_no_grip_is_above_the_ceiling_or_below_zero_or_faster_than_the_drive(
    lag_ms: float, targets: list[float]
) -> None:
    actuator = drive_of(lag_ms=lag_ms, ceiling_n=30.0)
    for target in targets:
        made = np.vstack([actuator.grip_n, grips(actuator, target, 0.02)])
        assert (made >= 0.0).all()
        assert (made <= 30.0).all()
        assert (
            np.abs(np.diff(made, axis=0)) <= actuator.fastest_n_s * DT_S + 1e-9
        ).all()


@pytest.mark.parametrize("lag_ms", [0.0, 20.0, 50.0, 100.0])
def test_a_drive_whose_target_is_its_own_grip_stands_still(lag_ms: float) -> None:
    actuator = drive_of(lag_ms=lag_ms)
    made = grips(actuator, actuator.own_n)
    assert (made == actuator.own_n).all()
    assert not actuator.moving(actuator.own_n).any()


def test_without_lag_the_grip_rises_at_full_speed_and_stops_at_the_target() -> None:
    actuator = drive_of(lag_ms=0.0, backlash_mm=0.0)
    own = actuator.own_n.copy()
    fastest = actuator.fastest_n_s
    made = grips(actuator, 40.0, 0.3)
    t_s = DT_S * np.arange(1, len(made) + 1)[:, None]
    assert made == pytest.approx(np.minimum(own + fastest * t_s, 40.0))


@pytest.mark.parametrize("lag_ms", [20.0, 50.0, 100.0])
@pytest.mark.parametrize("step_n", [-1.0, 1.0])
def test_a_small_step_is_critically_damped(lag_ms: float, step_n: float) -> None:
    actuator = drive_of(lag_ms=lag_ms, backlash_mm=0.0)
    lag_s = 1e-3 * lag_ms
    before = grips(actuator, actuator.own_n + 5.0, 20.0 * lag_s)[-1]
    target = before + step_n * np.minimum(1.0, 0.4 * actuator.own_n)
    share = (grips(actuator, target, 12.0 * lag_s) - before) / (target - before)
    t_s = DT_S * np.arange(1, len(share) + 1)[:, None]
    expected = 1.0 - (1.0 + t_s / lag_s) * np.exp(-t_s / lag_s)
    assert share.max() <= 1.02
    assert share[-1] == pytest.approx(1.0, abs=0.01)
    assert np.abs(share - expected).max() < 0.04


def test_a_hand_grips_for_the_larger_of_the_target_and_what_its_wearer_asks_for() -> (
    None
):
    actuator = drive_of()
    closed = actuator.own_n.copy()
    ways = np.linspace(1.0, -4.0, 200)[:, None] * closed
    # without a target the hand goes the way of its wearer, however fast that is
    for way in ways:
        assert (actuator.step(0.0 * closed, DT_S, way) == way).all()
    assert (actuator.grip_n == 0.0).all()

    actuator = drive_of(backlash_mm=0.0)
    grips(actuator, closed + 5.0)
    for way in ways:
        actuator.step(closed + 5.0, DT_S, way)
        assert actuator.grip_n == pytest.approx(closed + 5.0, abs=0.01)
    assert actuator.kept_n == pytest.approx(closed + 5.0, abs=0.01)

    # and once the target has ended it opens, by its own drive
    grips(actuator, 0.0, 0.02)
    assert (actuator.grip_n > 0.5 * closed).all()
    grips(actuator, 0.0, 2.0)
    assert (actuator.grip_n == 0.0).all()
    assert (actuator.place_n == ways[-1]).all()


def test_no_target_counts_while_the_wearer_opens_a_hand_that_can_tell() -> None:
    targets = np.array([8.0, 0.0, 8.0])
    opens = np.array([True, True, False])
    trials = LIVELY[:3]
    assert drive_of(trials).obeyed_n(targets, opens).tolist() == [0.0, 0.0, 8.0]
    cannot = Actuator(Drive(), trials, "larger")
    assert cannot.obeyed_n(targets, opens).tolist() == [8.0, 0.0, 8.0]


def test_the_fingers_follow_a_change_of_direction_after_the_backlash() -> None:
    actuator = drive_of(lag_ms=0.0, backlash_mm=0.5)
    up = grips(actuator, actuator.own_n + 5.0, 0.5)[-1]
    slack = actuator.backlash_n
    assert (slack > 0.1).all()
    assert (grips(actuator, up + 0.5 * slack, 0.1)[-1] == up).all()
    down = grips(actuator, actuator.own_n, 0.5)[-1]
    assert down == pytest.approx(actuator.own_n)
    assert (grips(actuator, down + 0.9 * slack, 0.1)[-1] == down).all()
    assert (grips(actuator, down + 1.5 * slack, 0.1)[-1] > down).all()
