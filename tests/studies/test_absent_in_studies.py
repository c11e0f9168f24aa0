"""In the studies too a class that is absent from the truth is a dash, and no zero in a mean."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from holdfast.evaluation.scores import LevelScores
from holdfast.training.figures import HeadFigures, PredictionFigures
from holdfast.training.metrics import situation_scores
from studies.fast_handover.window_scores import macro_f1
from studies.real.report import _row
from studies.scenes.evidence import macro_f1 as scenes_cell
from studies.scenes.evidence import number
from studies.tables.scenes import _scores

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


def test_a_row_of_real_recordings_has_a_dash_and_names_what_its_mean_is_over() -> None:
    figures = situation_scores(TRUTH, ANSWERED, list("abab"), n_draws=10)
    row = _row("ours", HeadFigures(4, 2, figures, PredictionFigures()))
    cells = row.split("<td>")[2:]
    assert (
        cells[0]
        == f"{F1:.3f}<br><span class=note>over nothing, grasp, risky slip alone</span>"
    )
    assert cells[2:6] == ["1.000", "0.667", "-", "1.000"]


def test_a_cell_of_the_scenes_names_what_its_mean_is_over() -> None:
    level = LevelScores(0.75, None, 0.9, None, {"grasp": 0.9, "safe_slip": None}, {}, 1)
    assert "over grasp alone" in scenes_cell(level)
    assert number(None) == "-"


def test_a_table_of_the_docs_names_what_its_mean_is_over() -> None:
    four = {"accuracy": 0.75, "macro_f1": 0.9, "f1": {"grasp": 0.9, "safe_slip": None}}
    calls = {name: {"share": None} for name in ("risky", "safe", "grasp")}
    row = _scores("ours", {"four": four, "calls": calls})
    assert row["4, macro F1"] == "0.900 over grasp alone"
    assert row["safe called risky"] is None, 'which the table shows as "-"'
