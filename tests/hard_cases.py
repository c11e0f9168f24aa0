"""The catalogue of hard cases, made of tests: a mark names the case, a run writes down how it went.

    @pytest.mark.hard_case(
        "Filter and features", "large offset", elsewhere="a cascade of filters loses the slip in rounding",
        here="only differences enter the bank",
    )
    def test_a_slip_on_an_offset_of_ten_thousand_is_seen(record_property): ...

`pytest -m hard_case --hard-cases=FILE` writes area, case, both sentences, test, outcome and what the test recorded with
`record_property` as JSON; tests/hard_cases_page.py makes docs/hard-cases.md of it. A test that shows what happens
without a guard carries the same mark and `unguarded=True`.
"""

from __future__ import annotations

import json
from collections.abc import Generator
from pathlib import Path
from typing import Any

import pytest

AREAS = ("Filter and features", "Forest and ONNX", "Calibration and metrics", "Simulation", "Time and schedule",
         "What comes from outside")  # fmt: skip
RESULTS = pytest.StashKey[list[dict[str, Any]]]()


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the results go."""
    parser.addoption("--hard-cases", type=Path, help="write how the hard cases went to this JSON file")


def pytest_configure(config: pytest.Config) -> None:
    """Nothing has run yet."""
    config.stash[RESULTS] = []


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note down every hard case that was run, or was skipped."""
    report = yield
    mark = item.get_closest_marker("hard_case")
    if mark is not None and (report.when == "call" or report.skipped):
        item.config.stash[RESULTS].append(told(mark) | {
            "test": item.nodeid, "outcome": report.outcome, "measured": dict(report.user_properties),
        })  # fmt: skip
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the file, if one was asked for."""
    path = session.config.getoption("--hard-cases")
    if path is not None:
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(json.dumps(session.config.stash[RESULTS], indent=1) + "\n", encoding="utf-8")


def told(mark: pytest.Mark) -> dict[str, Any]:
    """What a mark says. Raises ValueError for an area there is not, and TypeError for a sentence that lacks."""
    return _told(*mark.args, **mark.kwargs)


def _told(area: str, case: str, *, elsewhere: str, here: str, unguarded: bool = False) -> dict[str, Any]:
    if area not in AREAS:
        raise ValueError(f"{area!r} is none of {AREAS}")
    return {"area": area, "case": case, "elsewhere": elsewhere, "here": here, "unguarded": unguarded}
