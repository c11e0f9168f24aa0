"""The second physics: drawing, scoring and its file of trials; and nothing of ours leads to it.

The physics itself is tested in test_world_physics.py, where MuJoCo is installed.
"""

from __future__ import annotations

import json
import re
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from packages import ROOT, SHIPPED, folder_of

from benchmarks.world.draws import (
    KINDS,
    NEVER_S,
    RISKY,
    WorldTrial,
    draw_trial,
    with_intent,
)
from benchmarks.world.program import SEED, seed_line
from benchmarks.world.ranges import EVENT_N, HELD_N, RANGES, REFUSED_GRIP_N
from benchmarks.world.scores import table_of
from benchmarks.world.trials_file import TrialsFile
from holdfast.core.contract import Json
from holdfast.core.locked import locked_sets
from tools.doc_tables import tables_of

DEVELOPMENT = 150
LEADS = re.compile(r"benchmarks(\.|\s+import\s+)world")


@pytest.fixture(scope="module")
def trials() -> list[WorldTrial]:
    return [draw_trial(kind, k, DEVELOPMENT) for kind in KINDS for k in range(12)]


def test_no_import_leads_from_training_simulation_or_studies_to_it() -> None:
    folders = [*map(folder_of, SHIPPED), ROOT / "studies"]
    leading = []
    for path in (path for folder in folders for path in folder.rglob("*.py")):
        if LEADS.search(path.read_text("utf-8")):
            leading.append(str(path))
    assert leading == []


def test_its_seed_is_locked_and_the_program_says_so() -> None:
    locked = [seeds for seeds in locked_sets().seeds if "second physics" in seeds.about]
    assert [seeds.first <= SEED <= seeds.last for seeds in locked] == [True]
    assert "locked" in seed_line(SEED)
    assert "development" in seed_line(DEVELOPMENT)
    assert "no report" in seed_line(0)


def test_a_trial_depends_on_its_number_and_seed_alone() -> None:
    first = draw_trial("pull-fast", 3, DEVELOPMENT)
    again = draw_trial("pull-fast", 3, DEVELOPMENT)
    other = draw_trial("pull-fast", 4, DEVELOPMENT)
    assert first.numbers == again.numbers
    assert first.grip_n == again.grip_n
    assert first.numbers != other.numbers


def test_another_choice_of_signals_changes_the_wearers_signal_and_nothing_else(
    trials: list[WorldTrial],
) -> None:
    for trial in trials:
        assert with_intent(trial, "drawn") is trial
        if trial.open_s >= NEVER_S:
            assert with_intent(trial, "wired") is trial
            continue
        assert not with_intent(trial, "none").has_signal
        assert with_intent(trial, "always").has_signal
        wired = with_intent(trial, "wired")
        assert replace(wired, signal_s=trial.signal_s).numbers == trial.numbers
        if wired.has_signal:
            assert 0.08 <= trial.open_s - wired.signal_s <= 0.15


def test_nine_in_ten_signals_of_wired_wearers_come() -> None:
    signals = []
    for k in range(100):
        one = draw_trial("hand-over", k, DEVELOPMENT)
        signals.append(with_intent(one, "wired").has_signal)
    assert 0.82 < np.mean(signals) < 0.97


def test_every_number_is_within_its_range(trials: list[WorldTrial]) -> None:
    for trial in trials:
        for name, one in RANGES.items():
            if (trial.kind, name) != ("trembling-hold", "tremor_m_s2"):
                assert one.low <= trial.numbers[name] <= one.high
        assert REFUSED_GRIP_N[0] <= trial.grip_n <= REFUSED_GRIP_N[1]


def test_the_hand_is_held_any_way(trials: list[WorldTrial]) -> None:
    down = np.array([trial.gravity_m_s2 for trial in trials])
    assert np.allclose(np.sqrt((down * down).sum(axis=1)), 9.81)
    for axis in range(3):
        assert down[:, axis].min() < -5.0
        assert down[:, axis].max() > 5.0


def test_an_event_that_friction_does_not_hold_needs_more_than_the_grip(
    trials: list[WorldTrial],
) -> None:
    for trial in trials:
        needed = trial.need_n / trial.grip_n
        if trial.kind in ("pull-fast", "pull-slow", "tug-lost", "fall-weight"):
            assert EVENT_N[0] <= needed <= EVENT_N[1]
        if trial.kind == "fall-support":
            assert needed > 1.0
        if trial.kind == "tug-held":
            assert HELD_N[0] <= needed <= HELD_N[1]


def test_only_a_supported_object_is_held_too_weakly(trials: list[WorldTrial]) -> None:
    for trial in trials:
        if trial.kind not in RISKY and trial.kind != "tug-held":
            assert trial.need_n <= 0.8 * trial.grip_n + 1e-9


def record_of(kind: str, k: int, **changes: Any) -> Json:
    """A trial's record, as record.py writes it."""
    run = {"lost_s": None, "onset_s": 0.1, "slip_mm": 1.0, "peak_n": 4.0, "grip_n": 5.0}
    run |= {"peak_before_n": 3.0, "held_on_s": 0.0}
    counted = {
        "earlier": False,
        "called": False,
        "released_s": 0.0,
        "tightenings": 0,
        "quiet_s": 6.0,
        "most_n": 0.0,
    }
    trial = {
        "shape": "box",
        "mass_g": 100.0,
        "friction": 0.5,
        "friction_used": 0.4,
        "grip_n": 4.0,
        "need_n": 2.0,
        "tremor_m_s2": 0.1,
        "opens_s": 0.5 if kind == "hand-over" else None,
        "signal": False,
    }
    return {
        "name": f"{kind} {k}",
        "kind": kind,
        "pads": "point",
        "sensors": "chain",
        "refused": {"hold slides": 1},
        "trial": trial,
        "bare": run | changes.get("bare", {}),
        "oracle": changes.get("oracle"),
        "oracle_late": changes.get("late"),
        "answered": run | counted | changes.get("answered", {}),
    }


def row_of(table: Json, name: str) -> Json:
    (row,) = [r for r in (*table["kinds"], *table["groups"]) if r["kind"] == name]
    return row


def test_saved_counts_of_all_drops_of_the_preventable_and_without_earlier() -> None:
    lost = {"lost_s": 0.2}
    records = [
        record_of("pull-fast", 0, bare=lost, oracle="1.5"),
        record_of("pull-fast", 1, bare=lost, oracle="2", answered=lost),
        record_of("pull-fast", 2, bare=lost, oracle="2", answered={"earlier": True}),
        record_of("pull-fast", 3, bare=lost, answered=lost),
        record_of("pull-fast", 4),
        record_of("pull-fast", 5, answered=lost),
    ]
    row = row_of(table_of(records), "pull-fast")
    assert (row["drops"], row["preventable"]) == (4, 3)
    assert (row["saved_all"], row["saved_all_of"]) == (2, 4)
    assert (row["saved"], row["saved_of"]) == (2, 3)
    assert (row["saved_fresh"], row["saved_fresh_of"]) == (1, 2)
    assert row["new_drops"] == 1
    # Clopper and Pearson, two of three
    assert row["saved_share_ci"] == pytest.approx((0.0943, 0.9916), abs=1e-4)


def test_saved_stands_beside_a_hand_that_knows_20_ms_after_load_onset() -> None:
    lost = {"lost_s": 0.2}
    oracle = {"bare": lost, "oracle": "2"}
    records = [
        record_of("pull-fast", 0, **oracle, late="2"),
        record_of("pull-fast", 1, **oracle, late="3", answered=lost),
        record_of("pull-fast", 2, **oracle, late="3", answered=lost),
        record_of("pull-fast", 3, **oracle),
        record_of("pull-fast", 4, **oracle, answered={"earlier": True}),
    ]
    row = row_of(table_of(records), "pull-fast")
    assert (row["saved"], row["late_saves"], row["late_saves_of"]) == (3, 3, 5)
    assert row["beside_late"]["change"] == 0.0
    assert row["fresh_beside_late"]["change"] == pytest.approx(-0.25)
    low, high = row["beside_late"]["change_ci"]
    assert low < 0.0 < high


def test_what_the_rule_promises_stands_apart_from_comfort() -> None:
    bare = {"lost_s": 0.8}
    held_on = {"lost_s": 0.9, "held_on_s": 0.16, "peak_before_n": 5.0, "peak_n": 9.0}
    early = {"bare": {"lost_s": 0.3}, "answered": {"lost_s": 0.9}}
    records = [
        record_of("hand-over", 0, bare=bare, answered=held_on),
        record_of(
            "hand-over", 1, bare=bare, answered={"lost_s": 0.9, "held_on_s": 0.15}
        ),
        record_of("hand-over", 2, **early),
    ]
    rows = {row["opens"]: row for row in table_of(records)["hand_overs"]}
    row = rows["opens, no signal"]
    assert (row["held_after"], row["held_after_of"]) == (1, 3)
    assert row["before_n"]["p50"] == 0.0
    assert row["before_n"]["p95"] == pytest.approx(1.8)
    # it opens after 0.5 s: till then only the third receiver waits longer, by 0.2 s
    assert row["before_ms"]["p50"] == 0.0
    assert row["before_ms"]["p95"] == pytest.approx(180.0)


def test_of_the_oracles_commands_those_below_a_cap_keep_the_fewer_the_lower_it_is() -> (
    None
):
    lost = {"lost_s": 0.2}
    by = ("1.1", "2", "3", "ceiling", None)
    records = [
        record_of("pull-fast", k, bare=lost, oracle=one) for k, one in enumerate(by)
    ]
    rows = table_of(records)["oracle"]
    assert [(row["times"], row["kept"], row["kept_of"]) for row in rows] == [
        (1.1, 1, 4),
        (1.5, 1, 4),
        (2.0, 2, 4),
        (3.0, 3, 4),
        (None, 4, 4),
    ]


def test_what_is_to_leave_the_hand_is_no_drop() -> None:
    records = [record_of("hand-over", 0, bare={"lost_s": 0.8})]
    assert row_of(table_of(records), "all trials")["drops"] == 0


@pytest.mark.parametrize(
    ("answered", "is_blocked"),
    [
        ({"lost_s": 0.8}, False),
        ({"lost_s": 1.0, "peak_n": 8.9}, False),
        ({"lost_s": 1.2}, True),
        ({"lost_s": 0.8, "peak_n": 9.2}, True),
        ({"lost_s": None}, True),
    ],
)
def test_a_hand_over_is_blocked_by_force_by_time_or_for_good(
    answered: Json, is_blocked: bool
) -> None:
    one = record_of("hand-over", 0, bare={"lost_s": 0.8}, answered=answered)
    rows = {row["opens"]: row for row in table_of([one])["hand_overs"]}
    assert rows["opens, no signal"]["blocked"] == int(is_blocked)
    assert rows["opens, no signal"]["blocked_of"] == 1


def test_a_command_is_too_much_above_the_wearers_grip_and_the_need() -> None:
    records = [
        record_of("quiet-hold", k, answered={"most_n": most_n})
        for k, most_n in enumerate((0.0, 4.9, 5.1))
    ]
    assert row_of(table_of(records), "quiet-hold")["too_much"] == 1


def test_tightenings_of_quiet_holds_are_a_rate() -> None:
    records = [
        record_of("quiet-hold", k, answered={"tightenings": k}) for k in range(5)
    ]
    row = table_of(records)["quiet"][0]
    assert row["minutes"] == pytest.approx(0.5)
    assert row["per_min"] == pytest.approx(20.0)
    low, high = row["per_min_ci"]
    # Garwood's exact interval of ten counts: 4.80 to 18.39
    assert (low, high) == pytest.approx((9.59, 36.78), abs=0.01)


def figures_of(model: str, code: str = "a", oracle: Any = ()) -> Json:
    lost = {"lost_s": 0.2}
    records = [record_of(kind, 0) for kind in KINDS]
    records += [record_of(kind, 1, bare=lost, oracle="2") for kind in RISKY]
    records.append(record_of("hand-over", 1, bare=lost, answered=lost))
    return {
        "model": {"id": model},
        "commit": code,
        "code_sha256": code,
        "tables": [{**table_of(records), **({"oracle": oracle} if oracle else {})}],
    }


def test_the_page_shows_drops_by_event_and_what_receivers_feel() -> None:
    tables = tables_of("docs/results.md", {"world": figures_of("new")})
    assert "| all drops | " in tables["world"]
    assert "| opens, no signal | 1 | 0 " in tables["world-hand-overs"]


def test_a_stopped_run_goes_on_where_it_was(tmp_path: Path) -> None:
    about = {"seed": 1, "model": "a"}
    first = TrialsFile(tmp_path / "trials.jsonl", about)
    first.add({"name": "one", "value": 1})
    first.add({"name": "two", "value": 2})
    with first.path.open("a", encoding="utf-8") as file:
        file.write('{"name": "thr')  # torn by a kill
    again = TrialsFile(first.path, about)
    assert sorted(again.done) == ["one", "two"]
    again.add({"name": "three", "value": 3})
    whole = TrialsFile(first.path, about)
    assert [one["value"] for one in whole.of(["three", "one"])] == [3, 1]
    assert not whole.put_aside


def test_trials_of_another_model_are_put_aside(tmp_path: Path) -> None:
    path = tmp_path / "trials.jsonl"
    TrialsFile(path, {"model": "a"}).add({"name": "one"})
    other = TrialsFile(path, {"model": "b"})
    assert other.put_aside
    assert other.done == {}
    assert json.loads(path.read_text("utf-8")) == {"model": "b"}
    kept = path.with_suffix(".old.jsonl").read_text("utf-8").splitlines()
    assert len(kept) == 2
