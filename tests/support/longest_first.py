"""Begins with the files that take longest, so that no process waits for another at the end.

pytest-xdist gives each process the next file of the list; by itself it begins with the files of
most tests, and a long file of few tests comes last.
"""

from __future__ import annotations

from pathlib import Path

import pytest

LONGEST = (
    "test_pages",
    "test_adapt",
    "test_record_camera",
    "test_readme",
    "test_gripper_page",
    "test_closed_loop",
    "test_cli",
    "test_layout",
    "test_health",
    "test_camera_onset",
    "test_stream",
    "test_model_checks",
    "test_run_grip",
    "test_wheel",
    "test_train_command",
    "test_holds",
    "test_walks",
    "test_hard_forest",
    "test_robustness",
    "test_fast_handover",
    "test_released_models",
    "test_other_hands",
    "test_report_words",
    "test_evaluate_events",
    "test_hard_filter",
    "test_study_report",
    "test_real",
    "test_for_hand",
    "test_jobs",
    "test_preliminary",
    "test_c",
    "test_scenes_study",
    "test_runtimes",
    "test_camera_faults",
    "test_c_example",
    "test_loop_effects",
    "test_record_keys",
    "test_record_cut_off",
    "test_study",
    "test_run_intent",
    "test_calibration",
    "test_scenes",
)
"""Names of files, the longest first: 8 s or more."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of these files first; all others keep their order."""
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    name = Path(item.path).stem
    return LONGEST.index(name) if name in LONGEST else len(LONGEST)
