"""A hand held any way, and a grip that uses a drawn share of friction."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from holdfast.core.contract import NOTHING
from holdfast.core.errors import HoldfastError
from holdfast.core.trial_file import read_trial
from holdfast.data.timeline import read_truth
from holdfast.simulation.physics.body import GRAVITY_M_S2
from holdfast.simulation.scenes.folder import write_recording, write_set
from holdfast.simulation.scenes.holds import BOTH_CLOSED, LEAST_N, MOST_N
from holdfast.simulation.scenes.scene import Scene, SimulatedTrial
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.script_times import Times

WIDE = """
mass_g = { log_uniform = [10, 800] }
friction = { uniform = [0.2, 1.2] }
kinetic_share = { uniform = [0.6, 1.0] }
friction_factor = 1
used = { uniform = [0.1, 0.8] }
fingers_down = { uniform = [-1, 1] }
turn_deg = { uniform = [-180, 180] }
weak_share = 0
"""
TREMOR = "[effects.tremor]\namplitude_m_s2 = 3\n"


def scene(tmp_path: Path, values: str, action: str, effects: str = "") -> Scene:
    path = tmp_path / "mine.toml"
    path.write_text(
        '[[trials]]\nobjects = ["soft-ball", "full-bottle"]\n'
        f'action = "{action}"\ncount = 40\n{values}{effects}',
        encoding="utf-8",
    )
    return Scene(read_scene_file(str(path)), 100)


def held(simulated: SimulatedTrial) -> np.ndarray:
    """[S, 3] forces while the hand holds the object alone, just before the action."""
    times = Times.of(simulated.trial)
    sample = int(np.searchsorted(simulated.motion.t_s, times.act)) - 1
    return np.asarray(simulated.motion.forces_n[sample])


def used_and_drawn(made: Scene, count: int) -> tuple[np.ndarray, np.ndarray]:
    """Friction used by simulated holds, shear over limit, and what was drawn."""
    used, drawn = [], []
    for one in made.run_together(made.trials(count)):
        force = held(one)
        # The y axes of the fingers' sensors point the other way than the thumb's.
        sign = np.where(np.arange(6) < 2, -1.0, 1.0)
        y_n, z_n = force[:, 0].sum(), (force[:, 1] * sign).sum()
        limit_n = one.trial.object.friction * force[:, 2].sum()
        used.append(np.hypot(y_n, z_n) / limit_n)
        drawn.append(one.trial.drawn["used"])
    return np.asarray(used), np.asarray(drawn)


def test_the_friction_used_in_a_simulated_hold_is_the_one_drawn(
    tmp_path: Path,
) -> None:
    used, drawn = used_and_drawn(scene(tmp_path, WIDE + "offset_mm = 0\n", "pull"), 24)
    assert np.ptp(drawn) > 0.4
    # A cylinder is not squeezed along its axis, which the rule leaves out.
    assert used == pytest.approx(drawn, abs=0.065)


def test_fingers_beside_the_apex_use_no_more_friction_than_drawn(
    tmp_path: Path,
) -> None:
    """Their push is added to the load as if both had one direction, so it is a bound."""
    values = WIDE + "offset_mm = 4\ntouching = { choice = [3, 4, 6] }\n"
    used, drawn = used_and_drawn(scene(tmp_path, values, "pull"), 24)
    assert (used - drawn).max() < 0.08
    assert used.mean() > 0.5 * drawn.mean()


def test_every_grip_is_one_that_a_hand_can_have(tmp_path: Path) -> None:
    trials = scene(tmp_path, WIDE, "pass", TREMOR).trials()
    grips_n = np.array([trial.grip_n for trial in trials])
    used = np.array([trial.drawn["used"] for trial in trials])
    assert (grips_n >= LEAST_N).all()
    assert (grips_n <= MOST_N).all()
    assert (used < 0.801).all()
    for trial in trials:
        assert trial.down is not None
        weight_n = 1e-3 * trial.object.mass_g * GRAVITY_M_S2
        assert trial.grip_n >= BOTH_CLOSED * weight_n * abs(trial.down[0])


def test_tremor_counts_in_the_grip_of_a_hold(tmp_path: Path) -> None:
    values = "used = 0.4\nmass_g = 100\nweak_share = 0\nfriction_factor = 1\n"
    quiet = scene(tmp_path, values, "pass").trials(2)
    shaken = scene(tmp_path, values, "pass", TREMOR).trials(2)
    for one, other in zip(quiet, shaken, strict=True):
        ratio = (GRAVITY_M_S2 + 3.0) / GRAVITY_M_S2
        assert other.grip_n > 0.95 * ratio * one.grip_n


def test_refused_draws_are_counted_in_the_set(tmp_path: Path) -> None:
    made = scene(tmp_path, WIDE, "pass")
    refused = sum(trial.refused for trial in made.trials(4))
    assert refused > 0
    write_set(made, tmp_path / "set", 4)
    meta = json.loads((tmp_path / "set" / "meta.json").read_text())
    assert meta["draws"] == {"kept": 4, "refused": refused}


def test_ranges_that_allow_no_hold_are_an_error(tmp_path: Path) -> None:
    made = scene(tmp_path, "mass_g = 800\nfriction = 0.05\nused = 0.05\n", "pass")
    with pytest.raises(HoldfastError, match="none of 10000 draws"):
        made.trials(2)


def test_an_object_is_set_down_whichever_way_the_hand_is_held(tmp_path: Path) -> None:
    values = (
        "weak_share = 0\nused = 0.4\nmass_g = 150\nfriction = 0.6\npress = 1\nexcess_n = 0\n"
        "fingers_down = { uniform = [-0.5, 0.5] }\nturn_deg = { uniform = [-30, 210] }\n"
    )
    made = scene(tmp_path, values, "put-down")
    for one in made.run_together(made.trials(8)):
        opens = Times.of(one.trial).open
        before = int(np.searchsorted(one.motion.at_s, opens)) - 1
        down = one.trial.down
        assert down is not None
        carried_n = -(one.motion.agents_n[before] * down).sum()
        assert carried_n == pytest.approx(0.15 * GRAVITY_M_S2, rel=0.1)
        assert one.truth.gross_slip_s is None or one.truth.gross_slip_s > opens


def test_values_of_every_trial_give_way_to_those_of_a_row(tmp_path: Path) -> None:
    path = tmp_path / "every.toml"
    rows = '[[trials]]\nobjects = ["soft-ball"]\naction = "pass"\n'
    text = "[every_trial]\nhold_s = 1.5\nmass_g = 100\n" + rows + rows + "hold_s = 2\n"
    path.write_text(text, encoding="utf-8")
    trials = Scene(read_scene_file(str(path)), 0).trials()
    assert [trial.drawn["hold_s"] for trial in trials] == [1.5, 2.0]
    assert [trial.object.mass_g for trial in trials] == [100.0, 100.0]


def test_a_hold_that_a_table_bears_is_written_without_an_infinity_and_read_again(
    tmp_path: Path,
) -> None:
    """Strict JSON has none, and one trial in several hundred of `wide` is such a hold."""
    made = Scene(replace(read_scene_file("wide"), step_s=0.0067), 100)
    (borne,) = [one for one in made.trials() if one.number == 142]
    assert borne.drawn["used"] == np.inf
    write_recording(tmp_path / "trial_1", made, list(made.run([borne])))
    path = tmp_path / "trial_1.truth.json"
    assert json.loads(path.read_text("utf-8"))["drawn"]["used"] is None
    times_s = read_trial(tmp_path / "trial_1.csv").t_s
    assert read_truth(path).phases_on(times_s, path)[0].situation == NOTHING
