"""The scene of a pinch: what turns in the grip is in the truth, and who holds the book, holds it
upright."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.core.contract import RISKY_SLIP
from holdfast.simulation.scenes.folder import write_set
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import SceneFile, read_scene_file
from holdfast.simulation.scenes.script_times import Times
from holdfast.simulation.scenes.truth import GROSS_SLIP_M, GROSS_TURN_RAD

COARSE_S = 0.0067
SOON = {"close_at_s": 0.1, "hold_s": 0.9, "times": 1, "every_s": 0.8}
TAIL = {"tail_s": 0.2}


def pinch(action: str, **effects: dict[str, float] | None) -> SceneFile:
    """The scene with one action, coarse steps and other values of its effects; None: without."""
    file = read_scene_file("pinch")
    # Short trials: the move comes soon after the grip.
    file.effects["arm"] |= {"at_s": 1.4, "lasts_s": 0.5}
    changed = {}
    for name, values in file.effects.items():
        more = effects.get(name, {})
        if more is not None:
            changed[name] = {**values, **more}
    (row,) = [row for row in file.rows if row.action == action]
    values = {**row.values, **SOON}
    short = {name: value for name, value in values.items() if name in row.values}
    rows = (
        replace(row, values=short | TAIL if action != "nothing" else {"lasts_s": 1}),
    )
    return replace(file, step_s=COARSE_S, rows=rows, effects=changed)


def simulated(file: SceneFile, n: int) -> list[SimulatedTrial]:
    scene = Scene(file, 100)
    return scene.run_together(scene.trials(n))


def turned_rad(one: SimulatedTrial) -> np.ndarray:
    assert one.motion.turned_rad is not None
    return one.motion.turned_rad


def test_a_book_that_slips_or_turns_far_in_a_fast_move_is_a_risky_slip() -> None:
    found = set()
    for one in simulated(pinch("hold", rotation={"offset_y_mm": 8.0}), 10):
        times, motion = Times.of(one.trial), one.motion
        during = (motion.at_s >= times.act) & (motion.at_s < times.open)
        first = int(np.argmax(during))
        slipped_m = (motion.slip_m - motion.slip_m[first])[during & motion.gripped]
        turn_rad = (turned_rad(one) - turned_rad(one)[first])[during & motion.gripped]
        far = bool(
            (slipped_m >= GROSS_SLIP_M).any()
            or (np.abs(turn_rad) >= GROSS_TURN_RAD).any()
        )
        risky = RISKY_SLIP in {situation for _, situation in one.truth.marks}
        assert risky == far
        found.add((risky, bool((slipped_m >= GROSS_SLIP_M).any())))
    # Some hold, and some only turn.
    assert {(False, False), (True, False)} <= found


def test_who_hands_the_book_over_holds_it_upright() -> None:
    largest_deg = {}
    for held in (0.0, 0.3):
        trials = simulated(pinch("put-down", rotation={"people_n_m_s": held}), 6)
        angles = []
        for one in trials:
            given = one.motion.at_s <= Times.of(one.trial).give
            angles.append(np.degrees(np.abs(turned_rad(one)[given])).max())
        largest_deg[held] = max(angles)
    assert largest_deg[0.3] < 0.5 * largest_deg[0.0]


def test_skin_damps_a_swing() -> None:
    swings = {}
    for damping in (0.0, 0.05):
        changes = {"skin_n_m_s": damping, "offset_y_mm": 0.0}
        file = pinch("hold", rotation=changes, tremor=None)
        swings[damping] = [
            np.abs(np.diff(turned_rad(one)[one.motion.gripped])).sum()
            for one in simulated(file, 4)
        ]
    assert np.median(swings[0.05]) < 0.7 * np.median(swings[0.0])


def test_the_turn_stands_in_the_motion_where_an_effect_turns_objects(
    tmp_path: Path,
) -> None:
    write_set(Scene(pinch("pull"), 100), tmp_path / "with", 2)
    (path,) = sorted((tmp_path / "with").rglob("trial_1.motion.csv"))[:1]
    header, *rows = path.read_text("utf-8").splitlines()
    assert header.split(",")[1] == "object_turn_deg"
    turn_deg = np.array([float(row.split(",")[1]) for row in rows])
    assert turn_deg[0] == 0.0
    assert np.abs(turn_deg).max() > 1.0


@pytest.mark.parametrize("action", ["hold", "nothing"])
def test_the_pinch_is_felt_by_one_pad_only(action: str) -> None:
    for one in simulated(pinch(action), 2):
        assert one.signal.values.shape[1:] == (6, 3)
        assert one.motion.forces_n.shape[1] == 9
        assert (one.motion.forces_n[:, 6:, 2].max() > 0.3) == (action == "hold")
