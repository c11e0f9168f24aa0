"""What a grip controller is worth: drops saved, hand-overs blocked, and what it costs.

Each trial is run in a hand that does nothing (bare), by the oracle, and by the controller. A drop
is an object that the bare hand loses in a pull or a fall. It is preventable where one of several
closures of the same drive keeps the object; the oracle is, for each event, the gentlest that does.
A hand-over is blocked where the receiver needs over 5 N more than from the bare hand, gets the
object over 0.3 s later, or needs an override: that is comfort. What the wearer's rule promises
stands apart from it, divided by the wearer's opening: after it the hand does not hold on; before it
a receiver feels more force, and waits. All figures are simulated.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise

import numpy as np

from benchmarks.loop_baselines import may_slip, needed_grip_n
from holdfast.core.contract import BoolArray, FloatArray, Json
from holdfast.core.trial_layout import HELD_ACTIONS, SITUATION_OF_ACTION
from holdfast.data.metrics import Interval
from holdfast.evaluation.formats import share
from holdfast.simulation.loop.people import LoopOutcome

BLOCKED_N = 5.0
BLOCKED_S = 0.3
"""A hand-over that needs more force, or more time, than this is blocked."""
HELD_N = 0.5
HELD_S = 0.15
"""A hand that grips by more than HELD_N for HELD_S longer than the bare hand after the same opening
holds on."""
TIGHTER_N = 1.0
"""A hand that grips by so much more than its wearer commands is tightened."""
GRIPS_N = (0.0, 0.5, 1.0, 2.0, 5.0, 70.0)
"""Bounds of the wearer's grip by which drops are counted, N a side."""


@dataclass(frozen=True)
class ThreeRuns:
    """One trial in three hands."""

    bare: LoopOutcome
    oracle: LoopOutcome
    held: LoopOutcome

    @property
    def drop(self) -> bool:
        """The bare hand loses the object in an action in which it should stay in the hand."""
        # What falls before the action began was a weak grip, and no slip to be prevented.
        bare = self.bare
        in_action = bare.lost_s >= bare.act_s
        return may_slip(bare.trial.action) and in_action and bare.dropped

    @property
    def preventable(self) -> bool:
        """The bare hand drops it in the action, the oracle does not."""
        # The bare hand and the oracle bound what any controller can change.
        return self.drop and not self.oracle.dropped

    @property
    def over_need_n(self) -> float:
        """The largest grip while the object is held, beyond the wearer's and the need, N a side."""
        held = self.held
        while_held = _times_s(held) < min(held.lost_s, held.opens_s)
        most_n = float(held.grip_n[while_held].max(initial=0.0))
        enough_n = max(held.trial.grip_n, needed_grip_n(held.trial, 1.0))
        return max(0.0, most_n - enough_n)

    @property
    def called(self) -> bool:
        """A command by TIGHTER_N above the wearer's grip, in the event, while it is held."""
        held = self.held
        times_s = _times_s(held)
        until_s = min(held.lost_s, held.opens_s)
        in_event = (times_s >= held.act_s) & (times_s < until_s)
        beyond = held.target_n > held.own_n + TIGHTER_N
        return bool(beyond[in_event].any())

    @property
    def tightened_before(self) -> bool:
        """The hand was tightened in this hold, before the action began."""
        held = self.held
        before = _times_s(held) < held.act_s
        return bool(self.tight[before].any())

    @property
    def tight(self) -> BoolArray:
        """[T] where the hand grips by TIGHTER_N more than its wearer asks for."""
        is_tight: BoolArray = self.held.grip_n > self.held.own_n + TIGHTER_N
        return is_tight

    @property
    def completes(self) -> bool:
        """The bare hand hands the object over, after the action began."""
        return self.bare.act_s <= _taken_s(self.bare) < np.inf

    def hands_over(self, action: str) -> bool:
        """A hand-over of a kind; what the bare hand does not finish is none."""
        return self.completes and self.bare.trial.action == action

    @property
    def blocked(self) -> bool:
        """The hand-over needs more force, more time or an override."""
        # An override frees the object, yet the wearer had to see that the hand was wrong.
        overrides = bool(np.isfinite(self.held.overrode_s))
        return self.extra_n > BLOCKED_N or self.extra_s > BLOCKED_S or overrides

    @property
    def extra_n(self) -> float:
        """Force of the other person beyond what the bare hand asks for, N."""
        return self.held.peak_n - self.bare.peak_n

    @property
    def extra_s(self) -> float:
        """Time until the object has left, beyond that of the bare hand, s."""
        return _taken_s(self.held) - _taken_s(self.bare)

    @property
    def opened(self) -> bool:
        """The wearer opens the hand, and the bare hand lets go, while the trial is watched."""
        return bool(np.isfinite(_let_go_s(self.bare)))

    @property
    def held_after(self) -> bool:
        """The hand holds on after its wearer has opened it."""
        return _let_go_s(self.held) - _let_go_s(self.bare) > HELD_S

    @property
    def before_n(self) -> float:
        """Largest force of the other person before the opening, beyond the bare hand's, N."""
        return self.held.peak_before_n - self.bare.peak_before_n

    @property
    def before_s(self) -> float:
        """By how much longer than with the bare hand the other person waits before the opening."""
        opens_s = self.bare.opens_s
        return min(_taken_s(self.held), opens_s) - min(_taken_s(self.bare), opens_s)

    @property
    def excess_n_s(self) -> float:
        """Integral over time of the grip beyond what is needed, N s."""
        held = self.held
        trial = self.held.trial
        t_s = _times_s(held)

        # What the wearer commands is taken as needed, also where less would do.
        least_n = held.own_n.astype(np.float64)
        if may_slip(trial.action):
            # Before load onset nothing beyond the wearer's command is needed.
            since_onset = t_s >= held.onset_s
            needed_n = np.where(since_onset, needed_grip_n(trial), 0.0)
            least_n = np.maximum(least_n, needed_n)
        beyond_n = np.maximum(held.grip_n - least_n, 0.0)
        # After the object is gone the grip costs nothing.
        while_held_n = beyond_n[t_s < held.lost_s]
        return float(while_held_n.sum() / held.rate_hz)

    @property
    def friction_error(self) -> float:
        """Relative error of the friction estimate against the kinetic friction; nan without one."""
        # The estimate is made while the object slides, so it is kinetic friction that it measures.
        true = max(self.held.trial.kinetic_friction, 1e-9)
        return abs(self.held.mu_hat / true - 1.0)


def _times_s(of: LoopOutcome) -> FloatArray:
    """[T] times of the grip."""
    rows = np.arange(len(of.grip_n))
    times_s: FloatArray = of.begin_s + rows / of.rate_hz
    return times_s


def _let_go_s(of: LoopOutcome) -> float:
    """When the hand no longer grips after its wearer's opening; inf where that is not watched."""
    times_s = _times_s(of)
    # What has left the hand is not held, wherever its fingers are.
    free = (of.grip_n <= HELD_N) | (times_s >= of.lost_s)
    found = np.flatnonzero(free & (times_s >= of.opens_s))
    return float(times_s[found[0]]) if found.size else np.inf


def _taken_s(of: LoopOutcome) -> float:
    """When the object has left the hand, while the other person is there to take it; else inf."""
    return of.lost_s if of.lost_s < of.gives_up_s else np.inf


@dataclass(frozen=True)
class Counted:
    """So many (count) of so many (of) events; share and its exact 95 % interval, None of none."""

    count: int
    of: int
    share: float | None
    share_ci: Interval | None


def _counted(hits: Sequence[bool]) -> Counted:
    made = share(hits)
    return Counted(sum(hits), len(hits), made.share, made.share_ci)


@dataclass(frozen=True)
class SavedDrops:
    """Drops that a controller saved.

    of_all          of all drops of the bare hand
    of_preventable  of those that the oracle keeps
    untightened     of the preventable ones in whose hold the hand was not tightened before: those
                    that no earlier mistake saved
    """

    of_all: Counted
    of_preventable: Counted
    untightened: Counted


def _saved_drops(runs: Sequence[ThreeRuns]) -> SavedDrops:
    """Of the drops among some runs."""
    of_all = []
    of_preventable = []
    untightened = []
    for run in runs:
        if not run.drop:
            continue
        kept = not run.held.dropped
        of_all.append(kept)
        if run.preventable:
            of_preventable.append(kept)
        if run.preventable and not run.tightened_before:
            untightened.append(kept)

    return SavedDrops(_counted(of_all), _counted(of_preventable), _counted(untightened))


@dataclass(frozen=True)
class LoopFigures:
    """One controller on one set; shares from 0 to 1, `_ci` their exact 95 % intervals.

    drops: of the bare hand in pulls and falls. saved: of the preventable drops. saved_of_drops: of
    all. saved_untightened: of the preventable ones without an earlier tightening in that hold.
    by_action: the same by what happened to the object; by_grip: by the wearer's grip, N a side.
    over_need_n_by_action: by how much the grip exceeds the wearer's and the need, at most, while
    the object is held; the median of each action. slip_mm_p50: travel of what was saved.
    held_called: tugs, and pick_ups_called: lifts, that the bare hand holds and in which our command
    tightens. lost_in_holds: of what should stay in the hand, whatever the bare hand does.
    receiver_peak_n: largest force of a receiver. refused: hand-overs of which the receiver gives
    up. held_after_opening: of the hand-overs and put-downs in which the wearer opens the hand.
    before_force_n, before_delay_ms: of a receiver before that opening, beyond the bare hand.
    put_downs: disturbed as a hand-over is blocked. grip_excess: N s a trial beyond what is
    needed. tightenings_per_min: before any action, and in disturbed holds. new_drops: what the
    bare hand keeps, or loses before the action, and the controller loses. mu_error_p50: where a
    slip has shown friction.
    """

    trials: int
    drops: int
    preventable: int
    saved: int
    saved_share: float | None
    saved_share_ci: Interval | None
    saved_of_drops: Counted
    saved_untightened: Counted
    by_action: dict[str, SavedDrops]
    by_grip: dict[str, SavedDrops]
    over_need_n_by_action: dict[str, float | None]
    held_called: Counted
    pick_ups_called: Counted
    slip_mm_p50: float | None
    handovers: int
    blocked: int
    blocked_share: float | None
    blocked_share_ci: Interval | None
    refused: int
    receiver_peak_n_p50: float | None
    receiver_peak_n_p95: float | None
    extra_force_n_p50: float | None
    extra_force_n_p95: float | None
    extra_delay_ms_p50: float | None
    extra_delay_ms_p95: float | None
    held_after_opening: Counted
    before_force_n_p50: float | None
    before_force_n_p95: float | None
    before_delay_ms_p50: float | None
    before_delay_ms_p95: float | None
    put_downs: int
    disturbed_share: float | None
    disturbed_share_ci: Interval | None
    fragile: int
    lost_in_holds: Counted
    crushed_share: float | None
    crushed_share_ci: Interval | None
    grip_excess: float
    tightenings_per_min: float | None
    new_drops: int
    mu_observed: int
    mu_error_p50: float | None

    def to_json(self) -> Json:
        """As a JSON object, in the order of the fields."""
        return asdict(self)


def loop_figures(runs: Sequence[ThreeRuns]) -> LoopFigures:
    """The figures of one controller on one set."""
    passes = [run for run in runs if run.hands_over("pass")]
    put_downs = [run for run in runs if run.hands_over("put-down")]
    preventable = [run for run in runs if run.preventable]
    kept = [run for run in preventable if not run.held.dropped]

    drops = _saved_drops(runs)
    saved = drops.of_preventable
    blocked = _counted([run.blocked for run in passes])
    disturbed = _counted([run.blocked for run in put_downs])
    crushed = _crushed(runs)

    peaks_n = [run.held.peak_n for run in passes]
    extra_n = [run.extra_n for run in passes]
    delays_ms = [1e3 * run.extra_s for run in passes]
    before_n = [run.before_n for run in passes]
    before_ms = [1e3 * run.before_s for run in passes]
    friction_errors = _friction_errors(preventable)

    # Medians are of the cases that a share counts, so both describe the same trials.
    return LoopFigures(
        trials=len(runs),
        drops=drops.of_all.of,
        preventable=saved.of,
        saved=saved.count,
        saved_share=saved.share,
        saved_share_ci=saved.share_ci,
        saved_of_drops=drops.of_all,
        saved_untightened=drops.untightened,
        by_action=_by_action(runs),
        by_grip=_by_grip(runs),
        over_need_n_by_action=_over_need_n(runs),
        held_called=_called(runs, "tug"),
        pick_ups_called=_called(runs, "lift"),
        slip_mm_p50=_percentile([run.held.slip_mm for run in kept], 50),
        handovers=blocked.of,
        blocked=blocked.count,
        blocked_share=blocked.share,
        blocked_share_ci=blocked.share_ci,
        refused=sum(not np.isfinite(delay_ms) for delay_ms in delays_ms),
        receiver_peak_n_p50=_percentile(peaks_n, 50),
        receiver_peak_n_p95=_percentile(peaks_n, 95),
        extra_force_n_p50=_percentile(extra_n, 50),
        extra_force_n_p95=_percentile(extra_n, 95),
        extra_delay_ms_p50=_percentile(delays_ms, 50),
        extra_delay_ms_p95=_percentile(delays_ms, 95),
        held_after_opening=_held_after([*passes, *put_downs]),
        before_force_n_p50=_percentile(before_n, 50),
        before_force_n_p95=_percentile(before_n, 95),
        before_delay_ms_p50=_percentile(before_ms, 50),
        before_delay_ms_p95=_percentile(before_ms, 95),
        put_downs=disturbed.of,
        disturbed_share=disturbed.share,
        disturbed_share_ci=disturbed.share_ci,
        fragile=crushed.of,
        lost_in_holds=_lost_in_holds(runs),
        crushed_share=crushed.share,
        crushed_share_ci=crushed.share_ci,
        grip_excess=float(np.mean([r.excess_n_s for r in runs])) if runs else 0.0,
        tightenings_per_min=_tightenings_per_min(runs),
        new_drops=sum(run.held.dropped and not run.bare.dropped for run in runs),
        mu_observed=len(friction_errors),
        mu_error_p50=_percentile(friction_errors, 50),
    )


def _held_after(runs: Sequence[ThreeRuns]) -> Counted:
    """Openings after which the hand still grips, though the bare hand does not."""
    return _counted([run.held_after for run in runs if run.opened])


def _crushed(runs: Sequence[ThreeRuns]) -> Counted:
    """Fragile objects that were crushed; no other can be."""
    fragile = [run for run in runs if run.bare.trial.object.crush_n > 0.0]
    return _counted([run.held.crushed for run in fragile])


def _lost_in_holds(runs: Sequence[ThreeRuns]) -> Counted:
    """Objects that were lost in a hold that the wearer meant to last."""
    held = [run.held for run in runs if run.held.trial.action in HELD_ACTIONS]
    return _counted([one.dropped for one in held])


def _friction_errors(runs: Sequence[ThreeRuns]) -> list[float]:
    """Errors of the friction estimate; without a slip there is neither estimate nor error."""
    errors = [run.friction_error for run in runs]
    return [error for error in errors if np.isfinite(error)]


def _called(runs: Sequence[ThreeRuns], action: str) -> Counted:
    """Events of an action in which the bare hand holds the object, and ours tightens."""
    held = []
    for run in runs:
        if run.bare.trial.action == action and not run.bare.dropped:
            held.append(run.called)
    return _counted(held)


def _by_action(runs: Sequence[ThreeRuns]) -> dict[str, SavedDrops]:
    """The drops of every action that was run and has any."""
    found = {}
    for action in filter(may_slip, SITUATION_OF_ACTION):
        of_action = [run for run in runs if run.bare.trial.action == action]
        if of_action:
            found[action] = _saved_drops(of_action)
    return found


def _by_grip(runs: Sequence[ThreeRuns]) -> dict[str, SavedDrops]:
    """The drops by the wearer's grip before the event."""
    found = {}
    for low, high in pairwise(GRIPS_N):
        within = [run for run in runs if low <= run.held.trial.grip_n < high]
        found[f"{low:g} to {high:g}"] = _saved_drops(within)
    return found


def _over_need_n(runs: Sequence[ThreeRuns]) -> dict[str, float | None]:
    """By action, the median of the grip over what is needed; of drops the preventable ones."""
    by_action: dict[str, list[float]] = {}
    for run in runs:
        over_n = by_action.setdefault(run.held.trial.action, [])
        if run.preventable or not run.drop:
            over_n.append(run.over_need_n)
    return {action: _percentile(over_n, 50) for action, over_n in by_action.items()}


def _percentile(values: Sequence[float], percent: float) -> float | None:
    if not values:
        return None
    # What never happened is later than all else, and keeps the percentile finite.
    finite = np.where(np.isfinite(values), values, 1e6)
    return float(np.percentile(finite, percent))


def _tightenings_per_min(runs: Sequence[ThreeRuns]) -> float | None:
    """How often the grip rises by TIGHTER_N before any action, or where it should hold."""
    count = 0
    seconds = 0.0
    for run in runs:
        held = run.held
        # In an action more grip may be right, so only the time before it is watched.
        is_held = held.trial.action in HELD_ACTIONS
        until_s = held.opens_s if is_held else held.act_s
        # What should stay in the hand is watched until the hand opens.
        watched = _times_s(held) < min(until_s, held.lost_s)
        tight = run.tight[watched]
        # One rise above the limit counts once, however long the grip stays there.
        begins = tight[1:] & ~tight[:-1]
        count += int(begins.sum())
        seconds += len(tight) / held.rate_hz

    return 60.0 * count / seconds if seconds else None
