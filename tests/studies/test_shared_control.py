"""The study of shared control: what it runs, what its figure shows, and its targets."""

from __future__ import annotations

from typing import Any

import pytest

from holdfast.core.errors import UsageError
from studies.shared_control.closed_loop import scene_of
from studies.shared_control.plan import OURS, PARTS, SEED, rows, sets
from studies.shared_control.program import _chosen, merged
from studies.shared_control.targets import TARGETS, target_rows


def row(part: str, name: str, controller: str, **figures: Any) -> dict[str, Any]:
    """A row of loop.json; figures: those that matter."""
    whole: dict[str, Any] = {"part": part, "set": name, "controller": controller}
    whole |= {
        "setting": None,
        "lag_ms": 50.0,
        "opening": "wearer",
        "delay_samples": 0,
        "noise": 1.0,
        "grip_excess": 1.0,
    }
    for target in TARGETS:
        whole |= {target.key: target.bound, f"{target.key}_ci": [0.0, 1.0]}
    return whole | figures


def reached(*rows_of: dict[str, Any]) -> dict[str, str]:
    return {one["target"]: one["reached"] for one in target_rows(rows_of)}


def test_the_noise_of_the_chips_is_that_of_the_card_twice_and_four_times() -> None:
    noisy = [one for one in rows(100) if one.part == "noise" and one.set_name == "p1"]
    as_it_is = scene_of(sets(100)["p1"])[0].file.effects["hall_noise"]
    chips = [scene_of(one.one)[0].file.effects["hall_noise"] for one in noisy]
    assert [chip.get("averages", 32.0) for chip in chips] == [32.0, 8.0, 2.0]
    assert chips[0] == as_it_is


def test_a_target_is_reached_at_its_bound_and_not_beyond() -> None:
    at = {"saved_share": 0.95, "blocked_share": 0.02}
    assert set(reached(row("table", "author", OURS, **at)).values()) == {"yes"}
    beyond = row("table", "author", OURS, blocked_share=0.021, saved_share=0.94)
    assert [t for t, r in reached(beyond).items() if r == "no"] == [
        "drops saved, author's style",
        "hand-overs blocked, author's style",
    ]


def test_rows_are_chosen_by_part_set_and_controller() -> None:
    class Options:
        parts, sets, controllers = ("table",), ("p1",), (OURS,)

    (one,) = _chosen(rows(100), Options())  # type: ignore[arg-type]
    assert (one.part, one.set_name, one.label) == ("table", "p1", OURS)


def test_a_run_in_parts_keeps_the_rows_that_it_does_not_measure_again() -> None:
    one = row("table", "p1", OURS, tremor_m_s2=0.0, saved=1)
    again = one | {"saved": 2}
    other = row("table", "p2", OURS, tremor_m_s2=0.0, saved=3)
    facts = {"model": "d8", "seed": 7001}
    earlier = {**facts, "command": "a", "rows": [one, other]}
    both = merged(earlier, {**facts, "command": "b", "rows": [again]})
    assert both["rows"] == [other, again]
    assert both["command"] == "a; b"
    with pytest.raises(UsageError, match="earlier rows have seed 7001, these have 100"):
        merged(earlier, {**facts, "seed": 100, "command": "b", "rows": []})


def test_every_set_has_the_seed_that_was_asked_for() -> None:
    assert {one.one.seed for one in rows(10, 123)} == {123}
    assert {one.one.seed for one in rows(10)} == {SEED}
    assert {one.part for one in rows(10)} == set(PARTS)


def test_hands_open_late_or_never_and_tremble_in_sets_of_their_own() -> None:
    late = [one for one in rows(20) if one.part == "never opens"]
    _, trials = scene_of(late[0].one)
    assert {trial.action for trial in trials} == {"pass"}
    assert {trial.drawn["open_after_s"] for trial in trials} == {4.0}
    shaken = [one.one.tremor_m_s2 for one in rows(20) if one.part == "tremor"]
    assert shaken == [0.0, 0.3, 1.0, 2.0, 3.0]
