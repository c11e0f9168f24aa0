"""The catalogue of hard cases, made of tests: a mark names the case, a run writes down how it went.

    @pytest.mark.hard_case( "Filter and features", "large offset", elsewhere="a cascade of filters
        loses the slip in rounding", here="only differences enter the bank",
    )
    def test_a_slip_on_an_offset_of_ten_thousand_is_seen(record_property): ...

Hazards (hazard_marks.py, `--hazards=FILE`) are written down in the same way, and safety_page.py
makes docs/safety.md of them.

`pytest -m hard_case --hard-cases=FILE` writes area, case, both sentences, test, outcome and what
the test recorded with `record_property` as JSON; hard_cases_page.py makes docs/hard-cases.md of it.
A test that shows what happens without a guard carries the same mark and `unguarded=True`.
"""

from __future__ import annotations

import json
from collections.abc import Generator
from pathlib import Path
from typing import Any

import numpy as np
import pytest

AREAS = (
    "Filter and features",
    "Forest and ONNX",
    "Calibration and metrics",
    "Simulation",
    "Time and schedule",
    "What comes from outside",
)
Row = dict[str, Any]
PLACE = pytest.StashKey[int]()
OPTIONS = {"hard_case": "--hard-cases", "hazard": "--hazards"}
"""Marks whose tests are written down, and the option that names the file."""


def pytest_addoption(parser: pytest.Parser) -> None:
    """Where the results go."""
    for mark, option in OPTIONS.items():
        parser.addoption(
            option,
            type=Path,
            help=f"write how the tests marked {mark} went to this JSON file",
        )


def pytest_configure(config: pytest.Config) -> None:
    """Collect in the process that runs pytest; its xdist workers only report to it."""
    if not hasattr(config, "workerinput"):
        config.pluginmanager.register(Catalogue(config), "catalogue")


def pytest_collection_finish(session: pytest.Session) -> None:
    """Number the tests, so that the files do not depend on which worker was first."""
    for place, item in enumerate(session.items):
        item.stash[PLACE] = place


@pytest.hookimpl(wrapper=True)
def pytest_runtest_makereport(
    item: pytest.Item,
) -> Generator[None, pytest.TestReport, pytest.TestReport]:
    """Attach what its marks say to the report of a test that was run, or was skipped."""
    report = yield
    if report.when == "call" or report.skipped:
        marks = {"hard_case": details_of, "hazard": hazard}
        found = [(name, item.get_closest_marker(name)) for name in marks]
        # An attribute of a report survives the way from an xdist worker.
        report.catalogued = {  # type: ignore[attr-defined]
            name: marks[name](mark) for name, mark in found if mark is not None
        }
        report.place = item.stash[PLACE]  # type: ignore[attr-defined]
        report.user_properties = [
            (name, plain(value)) for name, value in report.user_properties
        ]
    return report


class Catalogue:
    """Gathers the reports of marked tests, whichever process ran them, and writes the files that
    the options name."""

    def __init__(self, config: pytest.Config) -> None:
        self.paths: dict[str, Path | None] = {
            mark: config.getoption(option) for mark, option in OPTIONS.items()
        }
        self.rows: dict[str, dict[int, Row]] = {mark: {} for mark in OPTIONS}

    def pytest_runtest_logreport(self, report: pytest.TestReport) -> None:
        """Note one test down."""
        for mark, details in getattr(report, "catalogued", {}).items():
            self.rows[mark][report.place] = details | {
                "test": report.nodeid,
                "outcome": report.outcome,
                "measured": dict(report.user_properties),
            }

    def pytest_sessionfinish(self) -> None:
        """Write the tests in the order in which they were collected."""
        for mark, path in self.paths.items():
            if path is not None:
                rows = [row for _, row in sorted(self.rows[mark].items())]
                path.parent.mkdir(parents=True, exist_ok=True)
                path.write_text(json.dumps(rows, indent=1) + "\n", encoding="utf-8")


def plain(value: object) -> object:
    """A number of numpy's as one of Python's: only those travel between processes."""
    return value.item() if isinstance(value, np.generic) else value


def hazard(mark: pytest.Mark) -> dict[str, Any]:
    """What a hazard's mark says."""
    area, name = mark.args
    return {"area": area, "hazard": name, **mark.kwargs}


def details_of(mark: pytest.Mark) -> dict[str, Any]:
    """What a mark says. Raises ValueError for an area there is not, and TypeError for a sentence
    that lacks."""
    return _details(*mark.args, **mark.kwargs)


def _details(
    area: str, case: str, *, elsewhere: str, here: str, unguarded: bool = False
) -> dict[str, Any]:
    if area not in AREAS:
        raise ValueError(f"{area!r} is none of {AREAS}")
    return {
        "area": area,
        "case": case,
        "elsewhere": elsewhere,
        "here": here,
        "unguarded": unguarded,
    }
