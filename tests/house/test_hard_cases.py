"""The catalogue of hard cases: what a mark must say, what is written down, and that the page is not
stale."""

from __future__ import annotations

from pathlib import Path

from hard_cases import details_of

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "hard-cases.md"


def test_every_hard_case_of_this_run_is_on_the_page(request):
    marks = [
        mark
        for item in request.session.items
        if (mark := item.get_closest_marker("hard_case"))
    ]
    written = PAGE.read_text("utf-8")
    missing = {
        details_of(mark)["case"]
        for mark in marks
        if f"| {details_of(mark)['case']}" not in written
    }
    assert not missing, "make hard-cases"
