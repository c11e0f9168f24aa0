"""The closed loop beside MuJoCo: what is compared, and how the page says it; MuJoCo itself is not
needed."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from benchmarks.mujoco_loop import CARD, Figures, Force
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from tools.doc_tables import tables_of


def test_the_trials_are_of_an_object_that_both_worlds_have_alike(
    tmp_path: Path,
) -> None:
    path = tmp_path / "peer.toml"
    path.write_text(CARD, encoding="utf-8")
    trials = Scene(read_scene_file(str(path)), 0).trials()
    assert {trial.action for trial in trials} == {"pull", "pass"}
    for trial in trials:
        assert trial.object.kinetic_share == 1.0
        assert not trial.supported
        assert np.abs(trial.at_m[0]).max() == 0.0


def test_a_difference_is_the_larger_one_of_mean_and_peak() -> None:
    one = Force("normal 1", Figures(2.0, 9.0, 4.0), Figures(2.2, 1.0, 3.0))
    assert one.difference == pytest.approx(0.25)
    other = Force("normal 1", Figures(2.0, 9.0, 4.0), Figures(3.0, 9.0, 4.0))
    assert other.difference == pytest.approx(0.5)


def test_the_page_has_a_row_a_trial() -> None:
    hand = {"kept": True, "lost_s": 0.14, "slip_mm": 2.04, "blocked": False}
    world = {"none": hand | {"kept": False}, "holdfast": hand}
    forces = [{"difference": share} for share in (0.05, 0.12, 0.08)]
    trials = [
        {"action": action, "ours": world, "mujoco": world, "forces": forces}
        for action in ("pull", "pass")
    ]
    made = {"mujoco_loop": {"trials": trials}}
    table = tables_of("docs/scenes.md", made)["mujoco-loop"]
    assert "| pull | lost; kept, 2.0 mm | lost; kept, 2.0 mm | 12 | 8 |" in table
    assert "| pass | taken after 140 ms; taken after 140 ms |" in table
