"""The page of the evaluation shows every figure under its column."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from page_tables import filled

from holdfast.evaluation.formats import CHOSEN, DEPLOYED
from studies.thesis_preliminary.published import LEARNERS

STREAM: dict[str, Any] = {
    "events": 20,
    "recall": 0.51,
    "recall_ci": [0.4, 0.6],
    "in_time": 0.31,
    "false_per_min": 0.7,
    "delay_ms": {"p50": 12.5},
    "lead_used": None,
    "safe_acts_called": {"share": 0.17, "n": 9},
}


def evaluated() -> dict[str, Any]:
    """Figures as `holdfast evaluate --json` writes them: two methods on one set."""
    rows = {CHOSEN: STREAM, DEPLOYED: STREAM, "one line of code": STREAM}
    return {
        "model": {"model_id": "abc"},
        "thresholds": {"headline": CHOSEN, "how": "by hand"},
        "all": {"rows": rows, "mcnemar": {"one line of code": {"p": 0.25}}},
        "sets": {"p1": {"rows": rows}},
    }


def preliminary() -> dict[str, Any]:
    """Figures of the preliminary study: one set, one case."""
    learners = {name: {"accuracy": {"mean": 0.5}} for name in LEARNERS}
    return {"sets": [{"data": "twenty", "cases": {"1": {"learners": learners}}}]}


def test_the_page_shows_every_figure_under_its_column(tmp_path: Path):
    figures = {
        "evaluated": evaluated(),
        "preliminary": preliminary(),
    }
    text = filled("docs/evaluation.md", figures, tmp_path)
    for line in (
        "| voluntary actions | 9 |",
        "| shear-rate threshold | 0.51 (0.40 to 0.60) | 0.31 | 0.7 | 12.5 | - | 0.17 | 0.25 |",
        "| p1 | 20 | 0.51 (0.40 to 0.60) | 0.31 | 0.7 | 12.5 | - | 0.17 |",
        "| 1 | twenty | 50 | 50 | 50 | 50 | 50 |",
    ):
        assert f"{line}\n" in text
