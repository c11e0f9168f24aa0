"""Late or in time, and hand-overs called: what the pictures show of an evaluation's figures."""

from __future__ import annotations

import json
import xml.etree.ElementTree as ET
from pathlib import Path
from typing import Any

import pytest

from holdfast.evaluation.formats import DEPLOYED
from studies.doc_pictures.timing import PICTURES
from tools.doc_pictures import EVALUATED, draw_measured


def evaluated(recall: float, in_time: float, called: float | None) -> dict[str, Any]:
    n = 0 if called is None else 40
    row = {"events": 20, "recall": recall, "in_time": in_time}
    share = {"share": called, "share_ci": [0.0, 0.5], "n": n}
    return {
        "data": {"kind": "simulated"},
        "rows": {DEPLOYED: {**row, "safe_acts_called": share}},
    }


@pytest.fixture
def drawn(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> dict[str, str]:
    sets = {"thesis": evaluated(1.0, 0.75, 0.1), "holds": evaluated(0.5, 0.25, None)}
    source = tmp_path / EVALUATED
    source.parent.mkdir(parents=True)
    source.write_text(json.dumps({"model": {"model_id": "abcdef012345"}, "sets": sets}))
    monkeypatch.chdir(tmp_path)
    draw_measured(tmp_path)
    return {name: (tmp_path / name).read_text("utf-8") for name in PICTURES}


def test_both_pictures_say_what_they_are_made_from(drawn: dict[str, str]) -> None:
    assert "simulated: 40 risky events, model abcdef" in drawn["late-or-in-time.svg"]
    assert (
        "simulated: 40 voluntary actions, model abcdef"
        in drawn["hand-overs-called.svg"]
    )
    for picture in drawn.values():
        root = ET.fromstring(picture)
        assert root.get("role") == "img"
        assert "simulated" in root.get("aria-label", "")


def test_a_set_without_voluntary_actions_has_no_line(drawn: dict[str, str]) -> None:
    assert ">holds</text>" in drawn["late-or-in-time.svg"]
    assert ">holds</text>" not in drawn["hand-overs-called.svg"]


def test_without_figures_the_pictures_stay(
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
    capsys: pytest.CaptureFixture[str],
) -> None:
    monkeypatch.chdir(tmp_path)
    draw_measured(tmp_path)
    assert f"{EVALUATED} is not there" in capsys.readouterr().out
    assert list(tmp_path.iterdir()) == []
