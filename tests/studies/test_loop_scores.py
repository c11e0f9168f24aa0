"""Figures of a grip controller, from outcomes made by hand."""

from __future__ import annotations

import json
from collections.abc import Iterator
from dataclasses import replace
from itertools import count
from typing import Any

import numpy as np
import pytest

from benchmarks.loop_baselines import needed_grip_n
from benchmarks.loop_figures import LoopFigures, ThreeRuns, loop_figures
from holdfast.simulation.loop.people import LoopOutcome
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.scene_file import read_scene_file
from holdfast.simulation.scenes.script_times import Times

RATE_HZ = 100.0
TRIALS = {t.action: t for t in Scene(read_scene_file("thesis"), 0).trials(40)}
NUMBERS: Iterator[int] = count()


def trial_of(action: str, crush_n: float = 0.0) -> PlannedTrial:
    one = TRIALS[action]
    return replace(
        one, number=next(NUMBERS), object=replace(one.object, crush_n=crush_n)
    )


def outcome(trial: PlannedTrial, **changes: Any) -> LoopOutcome:
    """The object stays in a hand that does nothing until its wearer opens it."""
    times = Times.of(trial)
    end_s = min(times.end, times.open)
    kept: dict[str, Any] = {
        "lost_s": np.inf if end_s == times.end else times.open + 0.2,
        "onset_s": times.act + 0.02,
        "slip_mm": 0.0,
        "peak_n": 5.0,
        "overrode_s": np.inf,
        "begin_s": 0.0,
        "rate_hz": RATE_HZ,
        "mu_hat": np.nan,
        "grip_n": np.full(round(end_s * RATE_HZ), trial.grip_n, dtype=np.float32),
    }
    kept |= changes
    own_n = np.full(len(kept["grip_n"]), trial.grip_n, dtype=np.float32)
    quiet = np.zeros_like(own_n)
    unless: dict[str, Any] = {"own_n": own_n, "target_n": quiet, "p_risky": quiet}
    return LoopOutcome(trial=trial, **(unless | kept))


def drop(trial: PlannedTrial) -> dict[str, float]:
    return {"lost_s": Times.of(trial).act + 0.1}


def three(
    trial: PlannedTrial, bare: Any = None, best: Any = None, held: Any = None
) -> ThreeRuns:
    return ThreeRuns(
        *(outcome(trial, **(changes or {})) for changes in (bare, best, held))
    )


def risky(
    held_drops: bool = True, oracle_drops: bool = False, **held: Any
) -> ThreeRuns:
    """A pull that the bare hand loses."""
    trial = trial_of("pull")
    lost = drop(trial)
    return three(
        trial, lost, lost if oracle_drops else {}, (lost if held_drops else {}) | held
    )


def handed(**held: Any) -> ThreeRuns:
    return three(trial_of("pass"), held=held)


def later(trial: PlannedTrial, extra_s: float) -> dict[str, float]:
    return {"lost_s": Times.of(trial).open + 0.2 + extra_s}


def figures(*runs: ThreeRuns) -> LoopFigures:
    return loop_figures(runs)


# drops


def test_a_drop_is_preventable_where_the_oracle_keeps_what_the_bare_hand_loses() -> (
    None
):
    assert risky().preventable
    assert not risky(oracle_drops=True).preventable
    assert not three(trial_of("pull")).preventable
    clumsy = trial_of("pass")
    assert not three(clumsy, bare=drop(clumsy)).preventable
    fall = trial_of("fall")
    assert three(fall, bare=drop(fall)).preventable
    before_the_action = {"lost_s": Times.of(fall).act - 0.1}
    assert not three(fall, bare=before_the_action).preventable


def test_saved_is_what_the_controller_keeps_of_the_preventable_drops() -> None:
    kept = [risky(held_drops=False, slip_mm=mm) for mm in (1.0, 3.0, 8.0)]
    made = figures(*kept, risky(), risky(oracle_drops=True), handed())
    assert (made.trials, made.drops, made.preventable, made.saved) == (6, 5, 4, 3)
    assert (made.saved_of_drops.count, made.saved_of_drops.of) == (3, 5)
    assert made.saved_share == 0.75
    assert made.saved_share_ci == pytest.approx(
        (0.1941, 0.9937), abs=1e-4
    )  # Clopper and Pearson
    assert made.slip_mm_p50 == 3.0


def test_saved_is_counted_over_all_drops_too_where_the_oracle_fails_and_by_action() -> (
    None
):
    fall = trial_of("fall")
    runs = [
        risky(held_drops=False, oracle_drops=True),
        risky(oracle_drops=True),
        three(fall, bare=drop(fall)),
        three(trial_of("pull")),
    ]
    made = figures(*runs)
    assert (made.saved_of_drops.count, made.saved_of_drops.of) == (2, 3)
    assert (made.saved, made.preventable) == (1, 1)
    pulls, falls = made.by_action["pull"], made.by_action["fall"]
    assert (pulls.of_all.share, pulls.of_preventable.share) == (0.5, None)
    assert (falls.of_all.share, falls.of_preventable.share) == (1.0, 1.0)
    low, high = made.saved_of_drops.share_ci or (1.0, 0.0)
    assert low < 2 / 3 < high


def test_a_drop_in_a_hold_that_was_tightened_before_is_no_merit_of_the_answer() -> None:
    trial = trial_of("fall")
    act = round(Times.of(trial).act * RATE_HZ)
    shapes = {"early": (act - 60, act - 40), "late": (act + 1, act + 40)}
    runs = {}
    for name, (begins, ends) in shapes.items():
        grip_n = np.full(act + 50, trial.grip_n, dtype=np.float32)
        grip_n[begins:ends] += 2.0
        runs[name] = three(trial, bare=drop(trial), held={"grip_n": grip_n})
    assert runs["early"].tightened_before
    assert not runs["late"].tightened_before
    made = figures(*runs.values())
    assert (made.saved_untightened.of, made.saved) == (1, 2)
    # what the wearer grips for is no tightening
    held = {"own_n": grip_n, "grip_n": grip_n}
    assert not three(trial, held=held).tightened_before


# hand-overs


def test_a_hand_over_is_blocked_by_force_by_delay_or_by_an_override() -> None:
    assert not handed(peak_n=9.9).blocked
    assert handed(peak_n=10.1).blocked
    trial = trial_of("pass")
    assert not three(trial, held=later(trial, 0.29)).blocked
    assert three(trial, held=later(trial, 0.31)).blocked
    assert three(trial, held={"lost_s": np.inf}).blocked
    assert handed(overrode_s=4.0).blocked


def opening(trial: PlannedTrial, until_s: float, **more: Any) -> dict[str, Any]:
    """The hand grips until so long after its wearer opens it, on an object that stays."""
    opens = round(Times.of(trial).open * RATE_HZ)
    grip_n = np.full(opens + 60, 8.0, dtype=np.float32)
    grip_n[opens + round(until_s * RATE_HZ) :] = 0.4
    return {"grip_n": grip_n, "lost_s": Times.of(trial).open + 0.55, **more}


def test_a_hand_holds_on_where_it_grips_015_s_longer_than_the_bare_hand_that_opens() -> (
    None
):
    trial = trial_of("pass")
    bare = opening(trial, 0.1)
    assert not three(trial, bare, bare, opening(trial, 0.24)).held_after
    assert three(trial, bare, bare, opening(trial, 0.26)).held_after
    # what has left the hand is not held
    gone = opening(trial, 0.5, lost_s=Times.of(trial).open + 0.2)
    assert not three(trial, bare, bare, gone).held_after
    made = figures(*(three(trial, bare, bare, opening(trial, s)) for s in (0.2, 0.5)))
    assert (made.held_after_opening.count, made.held_after_opening.of) == (1, 2)
    # neither is measured where the trial ends before its wearer opens the hand
    assert figures(three(trial)).held_after_opening.of == 0


def test_force_and_waiting_before_the_opening_stand_apart_from_those_after_it() -> None:
    trial = trial_of("pass")
    early = {"lost_s": Times.of(trial).open - 0.3, "peak_before_n": 2.0}
    held = later(trial, 0.4) | {"peak_n": 30.0, "peak_before_n": 2.5}
    made = figures(three(trial, early, early, held))
    assert made.before_force_n_p95 == pytest.approx(0.5)
    assert made.before_delay_ms_p95 == pytest.approx(300.0)
    assert made.extra_delay_ms_p95 == pytest.approx(900.0)
    after = figures(three(trial, held=later(trial, 0.4)))
    assert (after.before_force_n_p95, after.before_delay_ms_p95) == (0.0, 0.0)


def test_extra_delays_are_in_ms_and_one_that_never_ends_is_huge_and_finite() -> None:
    trial = trial_of("pass")
    late = [three(trial, held=later(trial, extra_s)) for extra_s in (0.0, 0.1, 0.2)]
    assert figures(*late).extra_delay_ms_p50 == pytest.approx(100.0)
    stuck = figures(three(trial, held={"lost_s": np.inf}))
    assert stuck.extra_delay_ms_p95 == 1e6


def test_a_hand_over_that_fails_in_the_bare_hand_is_none() -> None:
    trial = trial_of("pass")
    for lost_s in (Times.of(trial).act - 0.2, np.inf):
        assert figures(three(trial, bare={"lost_s": lost_s})).handovers == 0


def test_a_receiver_who_has_given_up_gets_nothing() -> None:
    trial = trial_of("pass")
    gone = {"gives_up_s": Times.of(trial).open + 1.0}
    kept = three(trial, gone, gone, later(trial, 0.9) | gone | {"peak_n": 9.0})
    in_time = three(trial, gone, gone, later(trial, 0.2) | gone | {"peak_n": 7.0})
    assert kept.blocked
    made = figures(kept, in_time)
    assert (made.handovers, made.blocked, made.refused) == (2, 1, 1)
    assert made.receiver_peak_n_p50 == pytest.approx(8.0)
    too_late = three(trial, later(trial, 0.9) | gone, gone, gone)
    assert figures(too_late).handovers == 0


# cost


def test_grip_beyond_need_is_an_integral_over_time_until_the_object_has_left() -> None:
    trial = trial_of("pass")
    grip_n = np.full(100, trial.grip_n, dtype=np.float32)
    grip_n[50:] += 2.0
    one = three(trial, held={"grip_n": grip_n, "lost_s": 0.75})
    assert one.excess_n_s == pytest.approx(2.0 * 0.25, rel=1e-5)
    assert figures(one, handed()).grip_excess == pytest.approx(0.25, rel=1e-5)


def test_the_grip_that_a_pull_needs_is_no_excess_after_its_onset() -> None:
    trial = trial_of("pull")
    needed_n = needed_grip_n(trial)
    assert needed_n > trial.grip_n
    for onset_s, expected in ((0.0, 1.0), (2.0, needed_n + 1.0 - trial.grip_n)):
        held = {"grip_n": np.full(100, needed_n + 1.0), "onset_s": onset_s}
        assert three(trial, held=held).excess_n_s == pytest.approx(expected)


def test_a_fragile_object_is_crushed_by_more_than_it_bears() -> None:
    fragile = trial_of("pass", crush_n=20.0)
    runs = [three(fragile, held={"grip_n": np.full(50, n)}) for n in (19.0, 21.0)]
    made = figures(*runs, handed(grip_n=np.full(50, 90.0)))
    assert (made.fragile, made.crushed_share) == (2, 0.5)
    low, high = made.crushed_share_ci or (1.0, 0.0)
    assert low < 0.5 < high


def test_a_tightening_is_a_rise_by_a_newton_before_the_action() -> None:
    trial = trial_of("pass")
    act = round(Times.of(trial).act * RATE_HZ)
    grip_n = np.full(act + 100, trial.grip_n, dtype=np.float32)
    grip_n[20:40] += 2.0
    grip_n[60:80] += 0.5
    grip_n[100:120] += 2.0
    grip_n[act + 10 :] += 9.0
    made = figures(three(trial, held={"grip_n": grip_n}))
    assert made.tightenings_per_min == pytest.approx(
        60.0 * 2 / (act / RATE_HZ), rel=0.01
    )


def test_figures_of_nothing_are_null_and_every_figure_is_json() -> None:
    empty = figures().to_json()
    shares = ("saved_share", "saved_share_ci", "blocked_share")
    for name in (*shares, "slip_mm_p50", "mu_error_p50"):
        assert empty[name] is None
    whole = figures(risky(held_drops=False), handed()).to_json()
    json.dumps([empty, whole], allow_nan=False)


# why an object was lost, and commands above the need


def in_event(trial: PlannedTrial, before: float, then: float) -> Any:
    """[T] one value before the action, another from its first sample to the end of the trial."""
    times = Times.of(trial)
    samples = round(min(times.end, times.open) * RATE_HZ)
    act = round(Times.of(trial).act * RATE_HZ)
    values = np.full(samples, then, dtype=np.float32)
    values[:act] = before
    return values


def test_grip_over_need_is_beyond_the_wearers_too_and_only_while_it_is_held() -> None:
    trial = trial_of("pull")
    enough_n = max(trial.grip_n, needed_grip_n(trial, 1.0))
    below, above = (in_event(trial, 0.0, enough_n + n) for n in (-0.1, 4.0))
    assert three(trial, held={"grip_n": below}).over_need_n == 0.0
    held = three(trial, held={"grip_n": above})
    assert held.over_need_n == pytest.approx(4.0, abs=1e-4)
    gone = {"grip_n": above, "lost_s": Times.of(trial).act - 0.1}
    assert three(trial, held=gone).over_need_n == 0.0
    assert figures(held).over_need_n_by_action == {"pull": pytest.approx(4.0, abs=1e-4)}


def test_drops_are_counted_by_the_wearers_grip() -> None:
    one = risky(held_drops=False)
    grip_n = one.held.trial.grip_n
    (where,) = [name for name, drops in figures(one).by_grip.items() if drops.of_all.of]
    low, high = map(float, where.split(" to "))
    assert low <= grip_n < high
