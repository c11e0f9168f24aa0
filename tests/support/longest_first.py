"""Begins with the files that take longest, so that no process waits for another at the end.

pytest-xdist gives each process the next file of the list; by itself it begins with the files of
most tests, and a long file of few tests comes last.
"""

from __future__ import annotations

from pathlib import Path

import pytest

LONGEST = (
    "test_readme",
    "test_adapt",
    "test_record_camera",
    "test_cli",
    "test_fast_handover",
    "test_run_grip",
    "test_real",
    "test_fuzz",
    "test_closed_loop",
    "test_scenes_study",
    "test_scenes",
    "test_preliminary",
    "test_live",
    "test_c",
    "test_evaluate_events",
    "test_health",
    "test_selftest",
    "test_released_models",
    "test_bench_hand",
    "test_bench",
)
"""Names of files, the longest first: 12 s of the processor or more."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of these files first; all others keep their order."""
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    name = Path(item.path).stem
    return LONGEST.index(name) if name in LONGEST else len(LONGEST)
