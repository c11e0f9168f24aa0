"""A model that learned from people together with scenes is not scored on these people."""

from __future__ import annotations

import json
from pathlib import Path
from typing import TYPE_CHECKING

import pytest
from test_real_lifts import write_lifts

from holdfast.cli.main import main
from holdfast.core.hand_card import HANDS
from holdfast.edge_runtime.model import Model

if TYPE_CHECKING:
    from conftest import Built


@pytest.mark.filterwarnings("ignore::holdfast.step.spec.BandsLeftOut")
@pytest.mark.filterwarnings("ignore::holdfast.training.fitting.FewWindows")
@pytest.mark.filterwarnings("ignore::holdfast.training.fitting.FewGroups")
def test_scenes_and_people_train_one_file_which_is_not_scored_on_these_people(
    tmp_path: Path,
    eight_classes: Built,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.setenv("HOLDFAST_DATA", str(tmp_path))
    (tmp_path / "grip_lift_ati").mkdir()
    write_lifts(tmp_path / "grip_lift_ati")
    made = tmp_path / "made"
    words = ["train", "--data", str(eight_classes.fixture), "grip_lift_ati"]
    words += ["--features", "pooled", "--learner", "forest", "--size", "tiny"]
    words += ["--out", str(made)]
    assert main(words) == 0
    index = json.loads((made / "artifact.json").read_text("utf-8"))
    scenes, lifts = index["training"]["sets"]
    assert lifts["people"] == ["p1547"]
    assert lifts["licence"] == "Apache-2.0"
    assert lifts["rate_hz"] == pytest.approx(scenes["rate_hz"], rel=0.1)
    assert Model(made / "holdfast.onnx").card.has_weight
    capsys.readouterr()

    pads = str(tmp_path / "pads.onnx")
    hand = str(HANDS / "two-transducers.toml")
    assert main(["export", str(made), "--hand", hand, "--out", pads]) == 0
    assert main(["evaluate", pads, "--data", "grip_lift_ati"]) != 0
    assert "has learned from p1547 of grip_lift_ati" in capsys.readouterr().err
