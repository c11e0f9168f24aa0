"""The catalogue of hard cases: what a mark must say, what is written down, and that the page is not
stale."""

from __future__ import annotations

import json
import runpy
import shutil
import sys
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import execnet
import numpy as np
import pytest
from hard_cases import AREAS, PLACE, Catalogue, details_of, pytest_runtest_makereport
from hard_cases_page import lists

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs" / "hard-cases.md"


def row(
    test: str, outcome: str = "passed", *, unguarded: bool = False, **measured: Any
) -> dict[str, Any]:
    return {
        "area": AREAS[0],
        "case": "a case",
        "elsewhere": "it drifts",
        "here": "it does not",
        "unguarded": unguarded,
        "test": f"tests/test_x.py::{test}",
        "outcome": outcome,
        "measured": measured,
    }


def test_a_mark_that_names_no_area_or_lacks_a_sentence_is_refused():
    assert (
        details_of(pytest.mark.hard_case(AREAS[0], "a", elsewhere="b", here="c").mark)[
            "unguarded"
        ]
        is False
    )
    with pytest.raises(ValueError, match="none of"):
        details_of(pytest.mark.hard_case("weather", "a", elsewhere="b", here="c").mark)
    with pytest.raises(TypeError, match="here"):
        details_of(pytest.mark.hard_case(AREAS[0], "a", elsewhere="b").mark)


def test_the_page_has_a_line_a_case_which_counts_what_did_not_pass():
    written = lists([row("test_it_is_clean[a]"), row("test_it_is_clean[b]", "failed")])
    assert "| a case (1 failed) | it drifts | it does not |\n" in written
    assert "| a case | it drifts | it does not |\n" in lists([row("test_it_is_clean")])


@pytest.mark.parametrize("name", ["hard_cases", "safety"])
def test_a_page_keeps_its_prose_and_a_second_run_changes_nothing(
    name, tmp_path, monkeypatch
):
    hazard = {"hazard": "a hazard", "does": "it holds", "left": "Nothing"}
    (tmp_path / "rows.json").write_text(
        json.dumps([row("test_it_is_clean") | hazard]), "utf-8"
    )
    docs = ROOT / "docs" / f"{name.replace('_', '-')}.md"
    page = Path(shutil.copy(docs, tmp_path))
    script = str(ROOT / "tests" / "support" / f"{name}_page.py")
    monkeypatch.setattr(sys, "argv", [script, str(tmp_path / "rows.json"), str(page)])
    texts = []
    for _ in range(2):
        # in this process, which has loaded what fills a page
        runpy.run_path(script, run_name="__main__")
        texts.append(page.read_text("utf-8"))
    assert texts[0] == texts[1]
    assert texts[0].partition("<!--")[0] == docs.read_text("utf-8").partition("<!--")[0]
    assert "it holds" in texts[0] or "it does not" in texts[0]


def reported(request: pytest.FixtureRequest, place: int, measured: object) -> Any:
    """The report of a marked test as a worker of xdist sends it: bytes, and read again."""
    report = pytest.TestReport(
        f"tests/test_x.py::{place}",
        ("", 0, ""),
        {},
        "passed",
        None,
        "call",
        user_properties=[("off", measured)],
    )
    mark = pytest.mark.hard_case(AREAS[0], "a", elsewhere="b", here="c").mark
    item: Any = SimpleNamespace(
        stash={PLACE: place}, get_closest_marker={"hard_case": mark}.get
    )
    made = pytest_runtest_makereport(item)
    next(made)
    with pytest.raises(StopIteration):
        made.send(report)
    hook = request.config.hook
    sent = execnet.dumps(
        hook.pytest_report_to_serializable(config=request.config, report=report)
    )
    return hook.pytest_report_from_serializable(
        config=request.config, data=execnet.loads(sent)
    )


def test_what_workers_report_is_written_in_the_order_of_the_tests(request, tmp_path):
    paths = {"--hard-cases": tmp_path / "new" / "cases.json", "--hazards": None}
    catalogue = Catalogue(SimpleNamespace(getoption=paths.get))
    for place in (2, 0, 1):
        catalogue.pytest_runtest_logreport(reported(request, place, np.float64(place)))
    catalogue.pytest_sessionfinish()
    rows = json.loads((tmp_path / "new" / "cases.json").read_text())
    assert [row["test"] for row in rows] == [f"tests/test_x.py::{k}" for k in range(3)]
    assert rows[1] == {
        "area": AREAS[0],
        "case": "a",
        "elsewhere": "b",
        "here": "c",
        "unguarded": False,
        "test": "tests/test_x.py::1",
        "outcome": "passed",
        "measured": {"off": 1.0},
    }


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
