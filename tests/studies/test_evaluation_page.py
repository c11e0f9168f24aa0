"""The page of the evaluation: targets are held against what was measured, and the best change is
named."""

from __future__ import annotations

from pathlib import Path
from typing import Any

from hypothesis import given
from hypothesis import strategies as st
from page_tables import filled

from holdfast.evaluation.formats import CHOSEN, DEPLOYED
from studies.fast_handover.targets import TARGETS, target_rows
from studies.row_names import CLOCK, OURS, RAW
from studies.thesis_preliminary.published import LEARNERS


def row(idea: str, good: float, bad: float) -> dict[str, Any]:
    """A change that reaches `good` wherever more is better and `bad` wherever less is."""
    figures: dict[str, Any] = {"idea": idea}
    for target in TARGETS:
        for place in target.places:
            *way, last = place.split(".")
            here = figures
            for name in way:
                here = here.setdefault(name, {})
            here[last] = good if target.at_least else bad
    return figures


def test_a_target_is_reached_where_the_default_is_on_its_right_side():
    assert {one["reached"] for one in target_rows([row("default", 1.0, 0.0)])} == {
        "yes"
    }
    assert {one["reached"] for one in target_rows([row("default", 0.0, 100.0)])} == {
        "no"
    }


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_best_change_is_the_one_that_no_other_beats(one: float, other: float):
    rows = [row("default", one, 1.0 - one), row("other", other, 1.0 - other)]
    for target in target_rows(rows):
        assert (
            target["best change"] == ("other" if other > one else "default")
            or one == other
        )
        assert target["best"] in (max(one, other), 1.0 - max(one, other))


def test_of_several_places_the_worst_counts():
    figures = row("default", 1.0, 0.0)
    figures["f1_p2"] = 0.5
    style = next(
        one for one in target_rows([figures]) if "worse of p1" in one["target"]
    )
    assert (style["default"], style["reached"]) == (0.5, "no")


def test_a_change_without_the_figure_is_not_compared():
    figures = row("default", 0.9, 0.1)
    other = row("other", 1.0, 0.0)
    del other["worst_object"]
    rows = target_rows([figures, other])
    worst = next(one for one in rows if "worst object" in one["target"])
    assert (worst["best"], worst["best change"]) == (0.9, "default")


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
LEVELS: dict[str, Any] = {
    level: {"macro_f1": 0.91, "macro_f1_ci": [0.9, 0.92]} for level in ("four", "eight")
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


def fast_handover() -> dict[str, Any]:
    """Figures of the fast hand-over study: the default alone."""
    default = row("default", 0.9, 0.1) | {"f1_author_past": 0.95, "learner_us": 11.0}
    default["author"] |= {"delay_ms": {"p50": 14.0}}
    bound = {"samples_late": 1, "ms_late": 6.67, "f1_author": 0.99}
    return {"rows": [default], "bounds": [bound]}


def scenes() -> dict[str, Any]:
    """Figures as `make study NAME=scenes` writes them, at the rate that the page shows."""
    rows = {OURS: LEVELS, RAW: LEVELS}
    rate = {
        "rows": rows,
        "objects": {name: {"soft-ball": LEVELS} for name in rows},
        "styles": {"p1": {"rows": rows}},
        "others": {"apple": {"rows": rows}},
        "learning_curve": [{"trials": 100} | rows],
        "retrainings": {name: {"spread": {"grasp_light": 0.05}} for name in rows},
    }
    return {"rates": {"150": rate}}


def preliminary() -> dict[str, Any]:
    """Figures of the preliminary study: one set, one case."""
    learners = {name: {"accuracy": {"mean": 0.5}} for name in LEARNERS}
    return {"sets": [{"data": "twenty", "cases": {"1": {"learners": learners}}}]}


def relative_rotation() -> dict[str, Any]:
    """Figures of the relative label: one method."""
    task = {
        "macro_f1": 0.6,
        "macro_f1_ci": [0.5, 0.7],
        "auc": 0.8,
        "auc_ci": [0.7, 0.9],
    }
    return {
        "windows": {"safe_slip": 1234},
        "rows": {CLOCK: {"situations": task, "predict_250ms": task}},
    }


def test_the_page_shows_every_figure_under_its_column(tmp_path: Path):
    figures = {
        "evaluated": evaluated(),
        "handover": fast_handover(),
        "scenes": scenes(),
        "preliminary": preliminary(),
        "truer": relative_rotation(),
    }
    text = filled("docs/evaluation.md", figures, tmp_path)
    for line in (
        "| voluntary actions | 9 |",
        "| shear-rate threshold | 0.51 (0.40 to 0.60) | 0.31 | 0.7 | 12.5 | - | 0.17 | 0.25 |",
        "| p1 | 20 | 0.51 (0.40 to 0.60) | 0.31 | 0.7 | 12.5 | - | 0.17 |",
        "| default | 0.9 | 0.95 | 0.9 | 0.9 | 0.9 | 11 |",
        "| default | 0.9 | 0.9 | 0.1 | 0.1 | 0.1 | 0.1 | 14 |",
        "| trained on the author, evaluated on apple | 0.91 (0.90 to 0.92) | 0.91 (0.90 to 0.92) |",
        "| 100 | 0.91 | 0.91 | 0.91 | 0.91 |",
        "| grasp light | 0.05 | 0.05 |",
        "| 1 | twenty | 50 | 50 | 50 | 50 | 50 |",
        "| safe slip | 1,234 |",
        "| timing-only baseline | 0.6 (0.50 to 0.70) | 0.8 (0.70 to 0.90) |",
    ):
        assert f"{line}\n" in text
