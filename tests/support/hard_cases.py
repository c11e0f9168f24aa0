"""The catalogue of hard cases, made of tests: a mark names the case, a run writes down how it went.

    @pytest.mark.hard_case(
        "Filter and features", "large offset", elsewhere="a cascade of filters loses the slip in rounding",
        here="only differences enter the bank",
    )
    def test_a_slip_on_an_offset_of_ten_thousand_is_seen(record_property): ...

Hazards (hazard_marks.py, `--hazards=FILE`) are written down in the same way, and safety_page.py makes docs/safety.md
of them.

`pytest -m hard_case --hard-cases=FILE` writes area, case, both sentences, test, outcome and what the test recorded with
`record_property` as JSON; hard_cases_page.py makes docs/hard-cases.md of it. A test that shows what happens
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
RESULTS = pytest.StashKey[dict[str, list[dict[str, Any]]]]()
OPTIONS = {"hard_case": "--hard-cases", "hazard": "--hazards"}
"""Marks whose tests are written down, and the option that names the file."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the results go."""
    for mark, option in OPTIONS.items():
        parser.addoption(option, type=Path, help=f"write how the tests marked {mark} went to this JSON file")


def pytest_configure(config: pytest.Config) -> None:
    """Nothing has run yet."""
    nothing: dict[str, list[dict[str, Any]]] = {mark: [] for mark in OPTIONS}
    config.stash[RESULTS] = nothing


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(item: pytest.Item) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Note down every marked test that was run, or was skipped."""
    report = yield
    for name, tell in (("hard_case", told), ("hazard", hazard)):
        mark = item.get_closest_marker(name)
        if mark is not None and (report.when == "call" or report.skipped):
            item.config.stash[RESULTS][name].append(tell(mark) | {
                "test": item.nodeid, "outcome": report.outcome, "measured": dict(report.user_properties),
            })  # fmt: skip
    return report


def pytest_sessionfinish(session: pytest.Session) -> None:
    """Write the files that were asked for."""
    for mark, option in OPTIONS.items():
        path = session.config.getoption(option)
        if path is not None:
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_text(json.dumps(session.config.stash[RESULTS][mark], indent=1) + "\n", encoding="utf-8")


def hazard(mark: pytest.Mark) -> dict[str, Any]:
    """What a hazard's mark says."""
    area, name = mark.args
    return {"area": area, "hazard": name, **mark.kwargs}


def told(mark: pytest.Mark) -> dict[str, Any]:
    """What a mark says. Raises ValueError for an area there is not, and TypeError for a sentence that lacks."""
    return _told(*mark.args, **mark.kwargs)


def _told(area: str, case: str, *, elsewhere: str, here: str, unguarded: bool = False) -> dict[str, Any]:
    if area not in AREAS:
        raise ValueError(f"{area!r} is none of {AREAS}")
    return {"area": area, "case": case, "elsewhere": elsewhere, "here": here, "unguarded": unguarded}
