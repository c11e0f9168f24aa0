"""One learner on other hands: the scene is the same but for the hand, and so is the learner."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from live_bench import DEFAULT
from long_steps import long_steps

from holdfast.core.writing import write_whole
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from studies.__main__ import PROGRAMS
from studies.other_hands import HANDS, line_of, scene_text
from tools.harness import start

TINY = DEFAULT.with_name("holdfast-150hz-tiny.onnx")
SENSORS = {
    "six-fingertips": 6,
    "two-pad-gripper": 2,
    "three-fingertips": 3,
    "twelve-sensors": 12,
}


def planned(name: str, folder: Path) -> Scene:
    path = write_whole(folder / f"{name}.toml", scene_text(name))
    return Scene(read_scene_file(str(path)), 130)


@pytest.mark.parametrize("name", HANDS)
def test_trials_on_another_hand_have_the_same_objects_and_people(
    name: str, tmp_path: Path
) -> None:
    here, six = (planned(one, tmp_path) for one in (name, HANDS[0]))
    assert here.file.hand.n_sensors == SENSORS[name]
    pairs = zip(here.trials(), six.trials(), strict=True)
    assert all((a.action, a.object) == (b.action, b.object) for a, b in pairs)


def test_the_learner_of_six_fingertips_answers_on_a_gripper_of_two_pads(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    words = ["hands", "--hands", "two-pad-gripper", "--trials", "4", "--jobs", "1"]
    words += ["--seed", "130", "--model", str(TINY), "--out", str(tmp_path)]
    with long_steps():
        assert start("studies", PROGRAMS, words) == 0
    found = json.loads((tmp_path / "hands.json").read_text("utf-8"))
    (row,) = found["rows"]
    assert (row["hand"], row["sensors"]) == ("two-pad-gripper", 2)
    assert row["unknown"] < 0.5
    assert row["found_of"] > 0
    assert row["found"] > 0.5
    assert "two-pad-gripper: " in capsys.readouterr().out


def test_a_hand_on_which_too_few_trials_ran_for_a_share_has_none() -> None:
    shares = {"found": 0.5, "in_time": None, "called": None}
    counts = {"saved": 0, "preventable": 0, "blocked": 0, "handovers": 1}
    line = line_of({"hand": "two-pad-gripper", **shares, **counts})
    assert "0.500 found, - in time, - called" in line
