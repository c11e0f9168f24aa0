"""The study of shared control: what it runs, what its figure shows, and its targets."""

from __future__ import annotations

from argparse import Namespace
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from holdfast.core.errors import UsageError
from studies.shared_control.closed_loop import scene_of
from studies.shared_control.closing import Closes, away_n
from studies.shared_control.picture import front
from studies.shared_control.plan import LATE as LATE_ORACLE
from studies.shared_control.plan import OURS, PARTS, SEED, rows
from studies.shared_control.program import _chosen, _open_rows, draw, merged
from studies.shared_control.targets import LATE, TARGETS, target_rows


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
        "saved_untightened": {"share": 0.8, "share_ci": [0.0, 1.0]},
        "held_after_opening": {"share": 0.0, "share_ci": [0.0, 1.0]},
    }
    for target in TARGETS:
        whole |= {target.key: target.bound, f"{target.key}_ci": [0.0, 1.0]}
    return whole | figures


def reached(*rows_of: dict[str, Any]) -> dict[str, str]:
    return {one["target"]: one["reached"] for one in target_rows(rows_of)}


def test_a_target_is_reached_at_its_bound_and_not_beyond() -> None:
    held = {"count": 0, "of": 9, "share": 0.0, "share_ci": [0.0, 0.3]}
    at = {"saved_beside_late": 0.0, "held_after_opening": held}
    found = reached(row("table", "author", OURS, **at))
    assert found["held after its wearer's opening"] == "yes"
    assert set(found.values()) == {"yes"}
    beyond = row(
        "table",
        "author",
        OURS,
        saved_beside_late=-0.01,
        held_after_opening=held | {"share": 0.11},
    )
    missed = [target for target, yes in reached(beyond).items() if yes == "no"]
    assert missed == [LATE.words, "held after its wearer's opening"]


def test_an_aim_on_a_change_is_told_set_by_set_beside_the_same_trials_only() -> None:
    words = "receiver's force before the opening, 95 %"
    now = row("table", "author", OURS, before_force_n_p95=4.0)
    worse = row("table", "wide", OURS, before_force_n_p95=4.1)
    then = [
        row("table", name, OURS, before_force_n_p95=3.0) for name in ("author", "p1")
    ]
    assert words not in reached(now, worse)

    def found(*rows_of: dict[str, Any]) -> dict[str, str]:
        told = target_rows(
            rows_of, [*then, row("table", "wide", OURS, before_force_n_p95=3.0)]
        )
        return {one["target"]: one["reached"] for one in told}

    assert found(now)[words] == "yes"
    assert found(now, worse)[words] == "no"


def test_every_aim_says_why() -> None:
    assert all(target.why for target in TARGETS)


def test_a_row_of_an_earlier_version_has_no_figure_that_was_not_measured_then() -> None:
    earlier = row("table", "author", OURS)
    del earlier["held_after_opening"], earlier["saved_beside_late"]
    assert "held after its wearer's opening" not in reached(earlier)
    assert LATE.words not in reached(earlier)


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


def test_styles_that_no_choice_may_see_run_at_locked_seeds_only(
    capsys: pytest.CaptureFixture[str],
) -> None:
    class Options:
        sets = None

    class Named:
        sets = ("tugs", "slow")

    every = {one.set_name for one in _open_rows(10, 7101, Options())}  # type: ignore[arg-type]
    seen = {one.set_name for one in _open_rows(10, 100, Options())}  # type: ignore[arg-type]
    assert every - seen == {"p1", "p2", "quick", "slow"}
    assert "left out" in capsys.readouterr().out
    with pytest.raises(UsageError, match="slow is a style that no choice may see"):
        _open_rows(10, 100, Named())  # type: ignore[arg-type]


def test_the_oracle_that_knows_later_is_in_every_set_and_in_a_part_of_its_own() -> None:
    table = [one for one in rows(10) if one.label == LATE_ORACLE]
    every = {one.set_name for one in rows(10) if one.part == "table"}
    assert {one.set_name for one in table} == every
    assert {one.request.knows_after_s for one in table} == {0.02}
    late = [one for one in rows(10) if one.part == "knowing" and one.label != OURS]
    known = [(one.set_name, round(1e3 * one.request.knows_after_s)) for one in late]
    delays = [0, 7, 13, 27, 40]
    assert known == [(name, ms) for name in ("author", "tugs") for ms in delays]
    assert {one.request.delay_samples for one in late} == {0}


def test_a_run_in_parts_draws_no_picture_of_the_documents(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A picture of a few trials would stand on the page beside other figures."""
    monkeypatch.chdir(tmp_path)
    (tmp_path / "docs").mkdir()
    draw(Namespace(page=False, out=tmp_path), {"front", "table"}, {"rows": []})
    assert list((tmp_path / "docs").iterdir()) == []


def test_a_target_of_a_hand_that_closes_counts_for_two_seconds_from_the_contact() -> (
    None
):
    given_n = np.array([[9.0], [0.0], [5.0], [9.0]])
    wearers_n = np.array([[1.0], [2.0], [3.0], [3.0]])
    since_s = np.array([[-0.1], [0.1], [1.9], [2.1]])
    one = Closes(since_s, wearers_n, wearers_n, wearers_n, given_n)
    assert one.over(wearers_n).tolist() == [2.0]
    bare = replace(one, known_n=wearers_n - 0.5, given_n=0.0 * given_n)
    # what is known under a target is of the last sample without one
    assert away_n(one, bare).tolist() == [0.5]


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
