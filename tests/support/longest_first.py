"""Begins with the files that take longest, so that no process waits for another at the end.

pytest-xdist gives each process the next file of the list; by itself it begins with the files of
most tests, and a long file of few tests comes last.
"""

from __future__ import annotations

from pathlib import Path

import pytest

LONGEST = (
    "test_pages",
    "test_c",
    "test_readme",
    "test_record_camera",
    "test_import_kinds",
    "test_adapt",
    "test_closed_loop",
    "test_cost",
    "test_run_grip",
    "test_health",
    "test_evaluate_events",
    "test_two_pads",
    "test_real",
    "test_try_page",
    "test_stream",
    "test_released_models",
    "test_train_command",
    "test_runtimes",
    "test_loop_effects",
    "test_wheel",
    "test_record_keys",
    "test_record_cut_off",
    "test_line_senders",
    "test_settings",
    "test_budget",
    "test_camera_faults",
    "test_for_hand",
    "test_holds",
    "test_c_files",
    "test_examples",
    "test_scene_physics",
    "test_preliminary",
    "test_gaps_and_rates",
    "test_c_example",
    "test_model_file",
    "test_bytes",
    "test_run_replays",
    "test_report_words",
    "test_json",
    "test_jobs",
    "test_bench_hand",
    "test_scenes",
    "test_import_formats",
    "test_layout",
    "test_bench_latency",
    "test_dead_logs",
    "test_live",
    "test_study",
    "test_run_engine",
)
"""Names of files, the longest first: 3 s or more."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of these files first; all others keep their order."""
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    name = Path(item.path).stem
    return LONGEST.index(name) if name in LONGEST else len(LONGEST)
