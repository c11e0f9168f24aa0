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
    "test_run_grip",
    "test_health",
    "test_real",
    "test_fuzz",
    "test_fast_handover",
    "test_c",
    "test_closed_loop",
    "test_evaluate_events",
    "test_scenes_study",
    "test_pages",
    "test_selftest",
    "test_bench",
    "test_preliminary",
    "test_scenes",
    "test_live",
    "test_released_models",
    "test_loop_effects",
    "test_stream",
    "test_camera_faults",
)
"""Names of files, the longest first: 12 s of the processor or more."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of these files first; all others keep their order."""
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    name = Path(item.path).stem
    return LONGEST.index(name) if name in LONGEST else len(LONGEST)
