"""The study of shared control: what it runs, what its figure shows, and its targets."""

from __future__ import annotations

from typing import Any

import pytest

from holdfast.core.errors import UsageError
from studies.shared_control.closed_loop import scene_of
from studies.shared_control.picture import front
from studies.shared_control.plan import OURS, PARTS, SEED, rows
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
        "tremor_m_s2": 0.0,
        "over_need_n_by_action": {"fall": 1.0, "carry": None},
        "pick_ups_called": {"share": 0.1, "share_ci": [0.0, 1.0]},
    }
    for target in TARGETS:
        whole |= {target.key: target.bound, f"{target.key}_ci": [0.0, 1.0]}
    return whole | figures


def reached(*rows_of: dict[str, Any]) -> dict[str, str]:
    return {one["target"]: one["reached"] for one in target_rows(rows_of)}


def test_a_target_is_reached_at_its_bound_and_not_beyond() -> None:
    at = {"saved_share": 0.90, "blocked_share": 0.03, "disturbed_share": 0.03}
    at |= {"extra_force_n_p95": 3.0, "extra_delay_ms_p95": 60.0}
    assert set(reached(row("table", "author", OURS, **at)).values()) == {"yes"}
    at |= {"blocked_share": 0.031, "saved_share": 0.89}
    over = {"over_need_n_by_action": {"fall": 10.1}}
    beyond = row("table", "author", OURS, **at, **over)
    assert [t for t, r in reached(beyond).items() if r == "no"] == [
        "drops saved, author's style",
        "hand-overs blocked, author's style",
        "grip over need, median of the worst kind of event",
    ]


def test_a_hand_whose_board_is_never_told_has_targets_of_its_own() -> None:
    never = row("intent", "quick", "never", extra_force_n_p95=3.9)
    told = row("table", "quick", OURS, extra_force_n_p95=3.1, blocked_share=0.05)
    words = "receiver's extra force, 95 %, worst style"
    found = reached(never, told)
    assert found[words] == "no"
    assert found[f"{words}, no signal reaches the board"] == "yes"


def test_only_a_hand_that_trembles_enough_counts_for_its_tightenings() -> None:
    def trembling(tremor_m_s2: float) -> dict[str, Any]:
        more = {"tremor_m_s2": tremor_m_s2, "tightenings_per_min": 3.1}
        return row("tremor", "author", OURS, **more)

    words = "tightenings a minute, trembling with 1 m/s2 and more, worst"
    assert words not in reached(trembling(0.3))
    assert reached(trembling(0.3), trembling(1.0))[words] == "no"


def test_a_point_of_the_front_counts_its_sets_together_and_the_worst_force() -> None:
    made = []
    for name, force_n, over_n in (("author", 2.0, 7.0), ("tugs", None, 9.0)):
        more = {"over_need_n_by_action": {"fall": over_n, "carry": None}}
        counts = {"saved": 3, "preventable": 4, "extra_force_n_p95": force_n}
        made.append(row("front", name, "both", **counts, **more))
    (point,) = front(made)
    assert (point["saved"], point["preventable"]) == (6, 8)
    assert (point["extra_force_n"], point["over_need_n"]) == (2.0, 9.0)


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
