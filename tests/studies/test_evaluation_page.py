"""The page of the evaluation: targets are held against what was measured, and the best idea is
named."""

from __future__ import annotations

from typing import Any

from hypothesis import given
from hypothesis import strategies as st

from studies.tables.evaluation import TARGETS, targets


def row(idea: str, good: float, bad: float) -> dict[str, Any]:
    """An idea that reaches `good` wherever more is better and `bad` wherever less is."""
    told: dict[str, Any] = {"idea": idea}
    for _, _, side, places in TARGETS:
        for place in places:
            *way, last = place.split(".")
            here = told
            for name in way:
                here = here.setdefault(name, {})
            here[last] = good if side == "at_least" else bad
    return told


def test_a_target_is_met_where_the_default_reaches_it_on_the_right_side():
    assert {one["met"] for one in targets([row("default", 1.0, 0.0)])} == {"yes"}
    assert {one["met"] for one in targets([row("default", 0.0, 100.0)])} == {"no"}


@given(st.floats(0.0, 1.0), st.floats(0.0, 1.0))
def test_the_best_idea_is_the_one_that_nobody_beats(one: float, other: float):
    for told in targets([row("default", one, 1.0 - one), row("other", other, 1.0 - other)]):
        assert told["by"] == ("other" if other > one else "default") or one == other
        assert told["best"] in (max(one, other), 1.0 - max(one, other))


def test_of_several_places_the_worst_counts():
    told = row("default", 1.0, 0.0)
    told["f1_p2"] = 0.5
    style = next(one for one in targets([told]) if "style never met (worse" in one["target"])
    assert (style["default"], style["met"]) == (0.5, "no")


def test_an_idea_without_the_figure_is_not_compared():
    told = row("default", 0.9, 0.1)
    other = row("other", 1.0, 0.0)
    del other["worst_object"]
    worst = next(one for one in targets([told, other]) if "worst object" in one["target"])
    assert (worst["best"], worst["by"]) == (0.9, "default")
