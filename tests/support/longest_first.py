"""Begins with the files that take longest, so that no process waits for another at the end.

pytest-xdist gives each process the next file of the list; by itself it begins with the files of
most tests, and a long file of few tests comes last.
"""

from __future__ import annotations

from pathlib import Path

import pytest

LONGEST = (
    "test_import_kinds",
    "test_pages",
    "test_readme",
    "test_adapt",
    "test_c",
    "test_import_silence",
    "test_run_grip",
    "test_everyday",
    "test_health",
    "test_hand_card",
    "test_examples",
    "test_real",
    "test_run_replays",
    "test_closed_loop",
    "test_holds",
    "test_try_page",
    "test_c_files",
    "test_wheel",
    "test_two_pads",
    "test_unmeasured_axes",
    "test_released_models",
    "test_train_command",
    "test_bench_hand",
    "test_hand",
    "test_evaluate_events",
    "test_cost",
    "test_for_hand",
    "test_budget",
    "test_stream",
    "test_scene_physics",
    "test_gaps_and_rates",
    "test_preliminary",
    "test_scenes",
    "test_layout",
    "test_run_engine",
    "test_live",
    "test_run_soak",
    "test_jobs",
    "test_schedule",
    "test_bench_latency",
    "test_bench",
    "test_frozen",
    "test_dead_logs",
    "test_replay",
    "test_house",
    "test_your_data",
    "test_import",
    "test_c_example",
    "test_import_formats",
    "test_camera_onset",
    "test_terminal",
    "test_record_read",
    "test_runtimes",
    "test_lost_fingers",
    "test_study",
    "test_bank",
    "test_loop_effects",
    "test_whole_output",
    "test_cli",
    "test_scene_hard_cases",
    "test_line_source",
    "test_record_cut_off",
    "test_forest",
    "test_record_keys",
    "test_c_hand",
    "test_pinch",
    "test_mlx90393",
    "test_own_situations",
    "test_report_words",
    "test_cues",
    "test_thesis_layout",
    "test_sizes",
)
"""Names of files, the longest first: 3 s or more."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of these files first; all others keep their order."""
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    name = Path(item.path).stem
    return LONGEST.index(name) if name in LONGEST else len(LONGEST)
