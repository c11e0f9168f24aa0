"""A class that is absent from the truth is a dash in every table, and the macro F1 says so."""

from __future__ import annotations

import json
import re
import shutil
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
from command_line import Run

from holdfast.evaluation.formats import number, percent
from holdfast.training.figures import over

if TYPE_CHECKING:
    from conftest import Built


def test_evaluate_prints_a_dash_for_a_situation_that_the_set_does_not_have(
    run: Run, eight_classes: Built, tmp_path: Path
) -> None:
    shutil.copytree(eight_classes.fixture, tmp_path / "set")
    for action in [
        *(tmp_path / "set").glob("*/pass"),
        *(tmp_path / "set").glob("*/put-down"),
    ]:
        shutil.rmtree(action)
    files = ("--json", tmp_path / "figures.json", "--report", tmp_path / "report.html")
    code, out, err = run(
        "evaluate", eight_classes.model, "--data", tmp_path / "set", *files
    )
    assert code == 0, err
    assert re.search(
        r"^macro F1 over nothing, grasp, risky slip alone  0\.\d{3}", out, re.M
    )
    assert re.search(r"^  F1 safe_slip +-$", out, re.M)
    figures = json.loads((tmp_path / "figures.json").read_text("utf-8"))
    f1 = figures["situations"]["f1"]
    assert f1.pop("safe_slip") is None
    assert figures["situations"]["macro_f1"] == np.mean(list(f1.values()))
    page = (tmp_path / "report.html").read_text("utf-8")
    assert page.count("over nothing, grasp, risky slip alone") == 2, (
        "per sample and at windows"
    )
    rows = re.findall(r"<tr><th>(.*?)</th>(<td.*?)</tr>", page, re.S)
    cells = {name: re.findall(r"<td[^>]*>(.*?)</td>", cells) for name, cells in rows}
    assert cells["safe slip"] == ["", "", "-", "", ""]
    assert float(cells["grasp"][1]) > 0.5


def test_a_macro_f1_names_its_classes_only_where_one_is_absent() -> None:
    assert over({"grasp": 0.25, "safe_slip": 0.75}) == ""
    assert over({"grasp": 0.25, "safe_slip": None}) == "over grasp alone"
    assert (number(None), percent(None)) == ("-", "-")
