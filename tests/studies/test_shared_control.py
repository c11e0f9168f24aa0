"""The study of shared control: what it runs, what its figure shows, and its targets."""

from __future__ import annotations

from typing import Any

import pytest

from holdfast.core.errors import UsageError
from studies.shared_control.closed_loop import scene_of
from studies.shared_control.picture import curve, picture
from studies.shared_control.plan import LAGS_MS, OURS, PARTS, SEED, SETTINGS, rows, sets
from studies.shared_control.program import PAGE, _chosen, _locked_on, merged
from studies.shared_control.targets import TARGETS, target_rows
from tools.doc_tables import tables_of
from tools.table_rows import before_and_now


def row(part: str, name: str, controller: str, **figures: Any) -> dict[str, Any]:
    """A row of loop.json; figures: those that matter."""
    whole: dict[str, Any] = {"part": part, "set": name, "controller": controller}
    whole |= {
        "setting": None,
        "lag_ms": 50.0,
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


def test_a_point_of_a_curve_counts_the_sets_together() -> None:
    counts = {
        "saved": 1,
        "preventable": 10,
        "blocked": 0,
        "handovers": 5,
        "setting": 4.0,
    }
    more = counts | {"saved": 9, "blocked": 5}
    points = curve(
        [row("curve", "p1", OURS, **counts), row("curve", "quick", OURS, **more)]
    )
    assert points == [(0.5, 0.5)]


def test_the_picture_has_a_panel_for_every_lag() -> None:
    counts = {"saved": 1, "preventable": 2, "blocked": 1, "handovers": 4}
    made = [
        row("lag", "p1", which, lag_ms=lag_ms, setting=setting, **counts)
        for lag_ms in (50.0, *LAGS_MS)
        for which in SETTINGS
        for setting in (1.0, 2.0)
    ]
    drawn = picture({"rows": made})
    assert all(
        f"drive with a lag of {lag_ms:g} ms" in drawn for lag_ms in (20, 50, 100)
    )


def test_a_target_is_reached_at_its_bound_and_not_beyond() -> None:
    at = {"saved_share": 0.95, "blocked_share": 0.02}
    assert set(reached(row("table", "author", OURS, **at)).values()) == {"yes"}
    beyond = row("table", "author", OURS, blocked_share=0.021, saved_share=0.94)
    assert [t for t, r in reached(beyond).items() if r == "no"] == [
        "drops saved, author's style",
        "hand-overs blocked, author's style",
    ]


def test_of_several_unseen_styles_the_worst_counts() -> None:
    good, bad = (
        row("table", "p1", OURS, saved_share=1.0),
        row("table", "p2", OURS, saved_share=0.5),
    )
    assert reached(good)["drops saved, worst unseen style"] == "yes"
    assert reached(good, bad)["drops saved, worst unseen style"] == "no"


@pytest.mark.parametrize(("excess", "verdict"), [(2.0, "yes"), (1.9, "no")])
def test_our_grip_above_need_is_held_against_that_of_the_rivals(
    excess: float, verdict: str
) -> None:
    rival = row("table", "p1", "smsp", grip_excess=excess)
    verdicts = reached(row("table", "p1", OURS), rival)
    assert verdicts["grip above need over that of smsp, all styles"] == verdict


def test_rows_are_chosen_by_part_set_and_controller() -> None:
    class Options:
        parts, sets, controllers = ("table",), ("p1",), (OURS,)

    (one,) = _chosen(rows(100), Options())  # type: ignore[arg-type]
    assert (one.part, one.set_name, one.label) == ("table", "p1", OURS)


def test_a_figure_that_is_not_there_is_a_dash_in_the_tables() -> None:
    figures: dict[str, Any] = dict.fromkeys(("drops", "preventable", "handovers"), 0)
    figures |= dict.fromkeys(
        ("disturbed_share", "disturbed_share_ci", "tightenings_per_min")
    )
    none = dict.fromkeys(
        ("saved_share", "slip_mm_p50", "crushed_share", "extra_force_n_p50")
    )
    absent = row("table", "holds", OURS, **(figures | none))
    none_of = {"count": 0, "of": 0, "share": None, "share_ci": None}
    absent |= {"saved": 0, "saved_of_drops": none_of, "saved_untightened": none_of}
    absent["by_action"] = {}
    made = tables_of(PAGE, {"loop": {"rows": [absent]}})
    assert "| holds | 0 of 0: - | 0 of 0: - | 0 of 0: - | 0 |" in made["sets"]


def test_the_page_says_whether_the_seed_was_locked() -> None:
    facts = {"measured_on": "2026-11-23", "model": "d8", "command": "c", "rows": []}
    locked = {**facts, "seed": SEED, "locked_on": _locked_on(SEED)}
    said = tables_of(PAGE, {"loop": locked})["measured"]
    assert "Seed 7001, locked since 2026-11-23" in said
    chosen = {**facts, "seed": 150, "locked_on": _locked_on(150)}
    assert "a development seed" in tables_of(PAGE, {"loop": chosen})["measured"]


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


def test_the_figures_before_a_mend_stay_beside_the_new_ones() -> None:
    counts: dict[str, Any] = {"saved": 1, "preventable": 4}
    counts |= {"blocked": 0, "handovers": 5}
    counts |= {"extra_delay_ms_p95": 10.0, "tremor_m_s2": 2.0}
    old = row("tremor", "author", OURS, saved_share=0.25, **counts)
    new = row("tremor", "author", OURS, saved_share=0.75, **(counts | {"saved": 3}))
    other = row("tremor", "author", OURS, **(counts | {"tremor_m_s2": 3.0}))
    assert before_and_now([old, other], [new]) == [(old, new)]
    none = dict.fromkeys(("count", "of"), 0) | dict.fromkeys(("share", "share_ci"))
    new |= {"saved_of_drops": none, "extra_delay_ms_p50": 1.0}
    new |= {"tightenings_per_min": 1.0}
    figures: Any = {"loop": {"rows": [new]}, "before": {"rows": [old]}}
    made = tables_of(PAGE, figures)["mended"]
    assert "| 1 of 4: 0.25" in made
    assert "| 3 of 4: 0.75" in made


def test_what_a_smaller_command_saves_stands_beside_the_oracle_with_a_cap() -> None:
    capped = [one for one in rows(10) if one.part == "cap" and one.set_name == "wide"]
    labels = [one.label for one in capped]
    assert labels[0] == "grip raised by at most 2 N"
    assert labels[-1] == "oracle"
    assert "oracle, at most 2.5 x the need" in labels
    some = {"count": 1, "of": 4, "share": 0.25, "share_ci": [0.0, 1.0]}
    figures = {"saved": 1, "preventable": 4, "saved_share": 0.25, "blocked_share": 0.5}
    shares: dict[str, Any] = {"above_need": some, "squeezed": some}
    made = row("cap", "wide", labels[1], **figures, **shares)
    table = tables_of(PAGE, {"cap": {"rows": [made]}})["cap"]
    line = "| wide | grip raised by at most 4 N | 1 of 4: 0.25 (0.00 to 1.00) |"
    assert line in table


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


def test_the_worst_tremor_counts() -> None:
    made = [
        row("tremor", "author", OURS, tremor_m_s2=m_s2, saved_share=share)
        for m_s2, share in ((0.0, 1.0), (2.0, 0.5), (3.0, 0.9))
    ]
    (target,) = [
        one for one in target_rows(made) if "drops saved, tremb" in one["target"]
    ]
    assert (target["reached"], target["measured"][:3]) == ("no", "0.5")
    assert target["measured"].endswith("2 m/s2")
