"""The page of learners: every table has its place, and an absent figure is a dash."""

from __future__ import annotations

from typing import Any

from page_tables import filled

CASES = [(18, False), (48, False), (18, True)]


def row(macro_f1: float) -> dict[str, Any]:
    return {"situations": {"macro_f1": macro_f1, "macro_f1_ci": [0.5, 0.7]}}


def figures() -> dict[str, Any]:
    """As `make study NAME=learners` writes them."""
    names = {"forest": 0.61, "network": 0.62, "committee": 0.63}
    people = {
        f"p{k}": {name: value - 0.1 * k for name, value in names.items()}
        for k in range(3)
    }
    rows = {name: row(value) for name, value in names.items()}
    return {
        "studied": [
            {"channels": channels, "in_hand": in_hand, "rows": rows, "people": people}
            for channels, in_hand in CASES
        ]
    }


def streams() -> dict[str, Any]:
    """As `make study NAME=learner-streams` writes them."""
    share = {"share": 0.02, "share_ci": [0.01, 0.05], "n": 100}
    one = {
        "recall": 0.98,
        "recall_ci": [0.95, 1.0],
        "in_time": 0.9,
        "false_per_min": 0.4,
        "safe_acts_called": share,
    }
    holds = one | {"safe_acts_called": {"share": None, "share_ci": None, "n": 0}}
    sets = {
        "author": one,
        "asked-daily": one,
        "p1": one,
        "p2": one,
        "asked-holds": holds,
    }
    curve = [
        {"recall": recall, "called": called}
        for recall, called in ((1.0, 0.4), (0.98, 0.1))
    ]
    row = {
        "name": "network",
        "step_us": 170.4,
        "sets": sets,
        "unseen": one,
        "left_out": one,
    }
    return {"rows": [row | {"curve": [*curve, {"recall": 0.9, "called": 0.0}]}]}


def test_every_table_of_learners_has_a_place_in_the_page(tmp_path):
    times = {"times": {"forest": {"p50_us": 20.0, "p99_us": 40.0}}}
    made = {"learners": figures(), "network": times, "streams": streams()}
    text = filled("docs/learners.md", made, tmp_path)
    assert "| committee | 0.63 (0.50 to 0.70) | - | - |" in text
    assert "| committee | 0.430 | 0.530 | 0.630 | 3 of 3 |" in text
    assert "| forest | 20.0 | 40 | 1.00 |" in text
    assert (
        "| network | 170 | 0.98 (0.95 to 1.00) | 0.9 | 0.4 | 0.4 | 0.02 | 0.02 |"
        in text
    )
    assert (
        "| network | 0.98 (0.95 to 1.00) | 0.9 | 0.4 | 0.02 (0.01 to 0.05) | 0.02 | 0.02 | 0.1 |"
        in text
    )
