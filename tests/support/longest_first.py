"""Begins with the files that take longest, so that no process waits for another at the end.

pytest-xdist gives each process the next file of the list; by itself it begins with the files of
most tests, and a long file of few tests comes last.
"""

from __future__ import annotations

from pathlib import Path

import pytest

LONGEST = (
    "test_pages",
    "test_import_kinds",
    "test_c",
    "test_readme",
    "test_adapt",
    "test_run_grip",
    "test_train_command",
    "test_real",
    "test_loop_effects",
    "test_released_models",
    "test_try_page",
    "test_budget",
    "test_health",
    "test_wheel",
    "test_camera_faults",
    "test_two_pads",
    "test_for_hand",
    "test_layout",
    "test_bank",
    "test_examples",
    "test_cost",
    "test_bytes",
    "test_c_files",
    "test_gaps_and_rates",
    "test_import_silence",
    "test_holds",
    "test_closed_loop",
    "test_preliminary",
    "test_forest",
    "test_evaluate_events",
    "test_runtimes",
    "test_stream",
    "test_scenes",
    "test_scene_physics",
    "test_detectors",
    "test_run_replays",
    "test_bench_latency",
    "test_pinch",
    "test_record_cut_off",
    "test_c_hand",
    "test_bench_hand",
    "test_everyday",
    "test_learners",
    "test_import_formats",
    "test_scene_hard_cases",
    "test_run_engine",
    "test_learner_training",
    "test_your_data",
    "test_jobs",
    "test_hard_forest",
    "test_whole_output",
    "test_bench",
    "test_unmeasured_axes",
    "test_learned_people",
    "test_live",
    "test_frozen",
    "test_hand",
    "test_hard_filter",
    "test_record_camera",
    "test_hand_card",
    "test_record",
    "test_cli",
    "test_run_soak",
    "test_dead_logs",
    "test_record_keys",
    "test_human_slip_uskin",
    "test_model_file",
    "test_guard",
    "test_record_read",
    "test_replay",
    "test_line_source",
    "test_lost_fingers",
    "test_schedule",
)
"""Names of files, the longest first: 2.6 s or more of CPU time."""


@pytest.hookimpl(trylast=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put the tests of these files first; all others keep their order."""
    items.sort(key=_place)


def _place(item: pytest.Item) -> int:
    name = Path(item.path).stem
    return LONGEST.index(name) if name in LONGEST else len(LONGEST)
