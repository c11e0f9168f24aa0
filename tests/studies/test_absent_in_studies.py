"""In the studies too a class that is absent from the truth is a dash, and no zero in a mean."""

from __future__ import annotations

from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from holdfast.evaluation.html import render
from holdfast.evaluation.window_scores import LevelScores
from studies.fast_handover.window_scores import macro_f1
from studies.report import FUNCTIONS, TEMPLATES
from studies.row_names import OURS
from tools.doc_tables import tables_of

TRUTH, ANSWERED = np.array([0, 1, 1, 3]), np.array([0, 1, 2, 3])
"""No safe slip is in the truth, and one window is called one."""
F1 = (1.0 + 2 / 3 + 1.0) / 3


def test_the_fast_handover_study_averages_the_situations_in_the_truth() -> None:
    streams: Any = SimpleNamespace(trials=[], lengths=[], row=np.arange(4), label=TRUTH)
    streams.trials = [
        SimpleNamespace(recording=SimpleNamespace(phases=(), rate_hz=50.0))
    ]
    streams.lengths = [4]
    assert macro_f1(streams, ANSWERED) == pytest.approx(F1)


def level_cell(level: LevelScores) -> str:
    return str(render("level.html", TEMPLATES, level=level, **FUNCTIONS))


def test_a_cell_of_the_scenes_names_what_its_mean_is_over() -> None:
    level = LevelScores(0.75, None, 0.9, None, {"grasp": 0.9, "safe_slip": None}, {}, 1)
    cell = level_cell(level)
    assert "0.900 (no interval)" in cell
    assert "over grasp alone" in cell
    assert "- (no interval)" in level_cell(replace(level, macro_f1=None))


def test_a_table_of_the_docs_names_what_its_mean_is_over() -> None:
    four = {"accuracy": 0.75, "macro_f1": 0.9, "f1": {"grasp": 0.9, "safe_slip": None}}
    calls = {name: {"share": None} for name in ("risky", "safe", "grasp")}
    rate: dict[str, Any] = {
        "rows": {"ours": {"four": four, "calls": calls}},
        "leak": {"eight_class_accuracy": 0.8, "eight_class_accuracy_ci99": (0.7, 0.9)},
        "objects": {},
        "others": {},
        "retrainings": {OURS: {"recall": {}, "spread": {}}},
    }
    scenes = {"rates": {"150": rate}, "headline_hz": "150"}
    forests = tables_of("docs/scenes.md", {"scenes": scenes})["forests"]
    assert "| - | - | 0.750 | 0.900 over grasp alone | - | - | - |" in forests
