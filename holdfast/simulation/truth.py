"""The truth of a trial, events and phases, from the core's own state, never from a sensor.

load onset      after the action begins, the force of people and box changes by LOAD_N
incipient slip  from then on, the first element of any touching brush slides
gross slip      all elements of all touching contacts slide, or the slip since load onset is 2 mm;
                an object that can turn (effect `rotation`) also slips as a whole once it has turned
                by 15 degrees since, the limit of human_slip_uskin between safe and not
contact lost    the last contact ends

In an everyday action (everyday.py) slips come and go, also without a load from outside. A slip is
a stretch of steps in which elements slide, with pauses of PAUSE_S at most, in which the object
slides as a whole or by 2 mm. It is risky from its load onset, or from its begin where no load from
outside caused it, to its end. Everything else is a grasp until the hand opens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
    FloatArray,
    Json,
)
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.simulation.protocol import ACTION_MODULES, PlannedTrial, action_module
from holdfast.simulation.script_times import CATCH_S, Times
from holdfast.simulation.stepper import TrialMotion

LOAD_N = 0.1
"""Change of the force of people and box that counts as load onset."""
GROSS_SLIP_M = 2e-3
"""Slip since load onset that counts as gross slip."""
PAUSE_S = 0.1
"""A pause without any sliding that ends a slip of an everyday action."""
GROSS_TURN_RAD = np.radians(15.0)
"""Turn in the grip since load onset that counts as gross slip."""
TRANSFERRED = 0.95
"""Share of the final force at which the weight counts as taken over."""
PROVENANCE = "scene"
"""Origin of a phase in the sidecar: the simulation itself, not a person or a detector."""
EVENTS = (
    "contact_s",
    "load_onset_s",
    "incipient_slip_s",
    "gross_slip_s",
    "contact_lost_s",
)
"""Fields of Truth that are events, in the order of their keys in the sidecar."""
Mark = tuple[float, int]
"""Start of a situation in s, and the number of the situation."""
Stretch = npt.NDArray[np.int64]
"""Numbers of steps."""


@dataclass(frozen=True)
class Truth:
    """Times in s, None for an event that never happened.

    contact_s         the first contact
    load_onset_s      the action begins to pull at the object
    incipient_slip_s  the first element of a brush slides
    gross_slip_s      everything slides, or the object has slipped 2 mm
    contact_lost_s    the last contact ends
    slip_mm           travel of the contacts from the first contact to the last
    marks             (start in s, situation), in order, until end_s
    end_s             of the trial
    """

    contact_s: float | None
    load_onset_s: float | None
    incipient_slip_s: float | None
    gross_slip_s: float | None
    contact_lost_s: float | None
    slip_mm: float
    marks: tuple[Mark, ...]
    end_s: float

    def to_json(self, shift_s: float = 0.0) -> Json:
        """As in trial_<n>.truth.json: events, and phases as intervals with their provenance.

        shift_s: where the trial begins in its recording.
        """
        phases = []
        stops_s = [since for since, _ in self.marks[1:]] + [self.end_s]
        for (start_s, situation), stop_s in zip(self.marks, stops_s, strict=True):
            if stop_s > start_s:
                phases.append(_phase(start_s + shift_s, stop_s + shift_s, situation))

        found: Json = {"phases": phases}
        for name in EVENTS:
            at_s = vars(self)[name]
            found[name] = None if at_s is None else round(at_s + shift_s, 6)

        return found | {"slip_mm": round(self.slip_mm, 4)}


def _phase(start_s: float, stop_s: float, situation: int) -> Json:
    """One phase of the sidecar, from start_s to stop_s."""
    return {
        "t0_s": round(start_s, 6),
        "t1_s": round(stop_s, 6),
        "onset_s": round(start_s, 6),
        "duration_s": round(stop_s - start_s, 6),
        "label": SITUATIONS[situation],
        "provenance": PROVENANCE,
    }


@dataclass
class _Steps:
    """Steps of a trial's events; None for one that it does not have.

    contact    the first one with contact
    lost       the first one after the last with contact, which may be one more than there are
    onset      load onset
    incipient  incipient slip
    gross      gross slip
    """

    contact: int
    lost: int
    onset: int | None = None
    incipient: int | None = None
    gross: int | None = None


def truth_of(trial: PlannedTrial, motion: TrialMotion) -> Truth:
    """Read the events of a trial from its steps."""
    # A sample lasts until the next one would come.
    end_s = 2.0 * float(motion.t_s[-1]) - float(motion.t_s[-2])
    everyday = trial.action in ACTION_MODULES
    if everyday and not trial.holds_object:
        touched: Truth = action_module(trial.action).touch_truth(motion)
        return touched
    held = np.flatnonzero(motion.gripped)
    if not held.size:
        return Truth(None, None, None, None, None, 0.0, ((0.0, NOTHING),), end_s)

    at_s = motion.at_s
    times = Times.of(trial)
    steps = _Steps(contact=int(held[0]), lost=int(held[-1]) + 1)
    marks: list[Mark] = [(0.0, NOTHING), (at_s[steps.contact], GRASP)]

    # An object that is never lost leaves the hand with the last step.
    gone_s = at_s[min(steps.lost, len(at_s) - 1)]
    if everyday:
        _mark_slips(marks, trial, motion, times, steps)
    else:
        _find_events(motion, times, steps)
        lost_early = steps.lost < len(at_s) and at_s[steps.lost] < times.act
        if "used" in trial.drawn and lost_early:
            _mark_failure(marks, motion, steps)
        elif trial.action == "hold":
            _mark_disturbances(marks, motion, times, steps.lost)
        elif steps.onset is None or steps.onset >= steps.lost:
            pass  # the action loads nothing while the object is held
        elif trial.action not in RISKY_ACTIONS:
            _mark_hand_over(marks, trial, motion, times, steps.onset)
            # The taker may have the object before the hand opens.
            marks = [mark for mark in marks if mark[0] < gone_s]
        elif steps.gross is not None:
            # A pull or a fall that the grip withstands stays a grasp.
            marks.append((at_s[steps.onset], RISKY_SLIP))

    marks.append((gone_s, NOTHING))
    slip_m = motion.slip_m[steps.lost - 1] - motion.slip_m[steps.contact]
    return Truth(
        contact_s=_time(motion, steps.contact),
        load_onset_s=_time(motion, steps.onset),
        incipient_slip_s=_time(motion, steps.incipient),
        gross_slip_s=_time(motion, steps.gross),
        contact_lost_s=_time(motion, steps.lost),
        slip_mm=1e3 * float(slip_m),
        marks=tuple((float(since_s), what) for since_s, what in marks),
        end_s=end_s,
    )


def _find_events(motion: TrialMotion, times: Times, steps: _Steps) -> None:
    """Load onset, and the slip since then: what slipped while the grip closed does not count."""
    onset = load_onset(motion, times.act)
    steps.onset = onset
    if onset is not None:
        far = slipped_far(motion, onset)
        steps.incipient = _first(motion.slips, onset, steps.lost)
        steps.gross = _first(motion.slides | far, onset, steps.lost)


def slipped_far(motion: TrialMotion, since: int) -> BoolArray:
    """[K] whether the object has slipped or turned so far since a step that it is gross slip."""
    far = motion.slip_m - motion.slip_m[since] >= GROSS_SLIP_M
    if motion.turned_rad is None:
        return far
    turned_rad = motion.turned_rad - motion.turned_rad[since]
    return far | (np.abs(turned_rad) >= GROSS_TURN_RAD)


def _time(motion: TrialMotion, step: int | None) -> float | None:
    """The time of a step, s; None for none, and for one after the last."""
    if step is None or step >= len(motion.at_s):
        return None
    return float(motion.at_s[step])


def _step_at(motion: TrialMotion, at_s: float) -> int:
    """The first step at or after a time; one more than there are where none is."""
    return int(np.searchsorted(motion.at_s, at_s))


def change_n(motion: TrialMotion, since: int) -> FloatArray:
    """[K] size of the change of the force of people and box, N, since the step before a step."""
    change = motion.agents_n - motion.agents_n[max(since - 1, 0)]
    size_n: FloatArray = np.sqrt((change * change).sum(axis=1))
    return size_n


def load_onset(motion: TrialMotion, act_s: float) -> int | None:
    """The step at which the force of people and box has changed by LOAD_N; None: never."""
    first = _step_at(motion, act_s)
    return _first(change_n(motion, first) > LOAD_N, first)


def _mark_hand_over(
    marks: list[Mark],
    trial: PlannedTrial,
    motion: TrialMotion,
    times: Times,
    onset: int,
) -> None:
    """A hand-over: safe while the weight goes over, and again when the hand opens."""
    at_s = motion.at_s
    marks.append((at_s[onset], SAFE_SLIP))
    before_opening = at_s < times.open
    pauses = trial.action != "pass" or trial.drawn["wait_s"] != 0.0
    if not pauses or not before_opening[onset:].any():
        return

    # The force that people and box carry in the pause before the hand opens.
    size_n = change_n(motion, onset)
    plateau_n = size_n[before_opening][-1]
    taken = _first(size_n >= TRANSFERRED * plateau_n, onset)
    taken_s = at_s[onset if taken is None else taken]
    if taken_s < times.open:
        marks += [(taken_s, GRASP), (times.open, SAFE_SLIP)]


def _mark_disturbances(
    marks: list[Mark], motion: TrialMotion, times: Times, lost: int
) -> None:
    """A disturbed hold: a grasp, unless the object slips 2 mm or is lost before the hand opens."""
    at_s = motion.at_s
    acts = _step_at(motion, times.act)
    opens = _step_at(motion, times.open)
    stop = min(opens, lost)
    far = slipped_far(motion, min(acts, len(at_s) - 1))

    if _first(far, acts, stop) is not None:
        sliding = acts + np.flatnonzero(motion.slips[acts:stop])
        if not sliding.size:
            # It has turned with the skin, which slides nowhere.
            sliding = acts + np.flatnonzero(far[acts:stop])
        marks.append((at_s[sliding[0]], RISKY_SLIP))
        if lost > opens:
            # A slip that ends before the hand opens ends as a grasp.
            marks.append((at_s[sliding[-1]], GRASP))
    if lost > opens:
        marks.append((times.open, SAFE_SLIP))


def _stretches(motion: TrialMotion, start: int, stop: int) -> list[Stretch]:
    """The steps from start up to stop that slide, cut where a longer pause is between two."""
    sliding = start + np.flatnonzero(motion.slips[start:stop])
    pauses = np.flatnonzero(np.diff(motion.at_s[sliding]) > PAUSE_S) + 1
    return np.split(sliding, pauses) if sliding.size else []


def _mark_failure(marks: list[Mark], motion: TrialMotion, steps: _Steps) -> None:
    """A hold that fails by itself, in a scene that draws the friction used: a slip to its end."""
    # The slip that loses the object is the last one.
    stretches = _stretches(motion, steps.contact, steps.lost)
    begin = stretches[-1][0] if stretches else steps.lost
    marks.append((motion.at_s[begin], RISKY_SLIP))


def slip_onset(trial: PlannedTrial, motion: TrialMotion) -> int | None:
    """The step at which an everyday action begins to endanger the grip; None where it does not.

    It is the load onset where a load comes from outside, else the begin of the first slip.
    """
    times = Times.of(trial)
    if trial.action in action_module(trial.action).LOADED:
        onset = load_onset(motion, times.act)
        # The person who takes the object at the end is no load of the action.
        before_end = onset is not None and motion.at_s[onset] < times.open - CATCH_S
        return onset if before_end else None
    held = np.flatnonzero(motion.gripped)
    slips = _slips(motion, times, int(held[-1]) + 1) if held.size else []
    return slips[0][0] if slips else None


def _slips(motion: TrialMotion, times: Times, lost: int) -> list[tuple[int, int, int]]:
    """(begin, gross slip, end) of each slip of an everyday action, numbers of steps."""
    slips = []
    stop = min(_step_at(motion, times.open), lost)
    for part in _stretches(motion, _step_at(motion, times.act), stop):
        begin = int(part[0])
        end = int(part[-1]) + 1

        # Travel counts from the begin of this slip, not from that of the action.
        far = slipped_far(motion, begin)
        gross = _first(motion.slides | far, begin, end)
        # Elements that creep while the others hold move nothing.
        if gross is not None:
            slips.append((begin, gross, end))

    return slips


def _mark_slips(
    marks: list[Mark],
    trial: PlannedTrial,
    motion: TrialMotion,
    times: Times,
    steps: _Steps,
) -> None:
    """An everyday action: held, then every slip, and held again where the object stays."""
    at_s = motion.at_s
    lost = steps.lost
    loaded = trial.action in action_module(trial.action).LOADED
    slips = _slips(motion, times, lost)
    ended = steps.contact
    for begin, _, end in slips:
        start = _loaded_from(motion, times.act, begin) if loaded else begin
        if start > ended:
            marks.append((at_s[start], RISKY_SLIP))
        else:
            # The load of the slip before is still there: both are one.
            marks.pop()
        ended = end
        # A slip that lasts until the hand opens ends with the opening.
        if end < lost and at_s[end] < times.open:
            marks.append((at_s[end], GRASP))

    # An object that is still there is handed to a person as the hand opens.
    if lost >= len(at_s) or at_s[lost] >= times.open:
        marks.append((times.open, SAFE_SLIP))

    # The events are those of the first slip.
    if loaded:
        steps.onset = slip_onset(trial, motion)
    if slips:
        steps.incipient, steps.gross, _ = slips[0]


def _loaded_from(motion: TrialMotion, act_s: float, begin: int) -> int:
    """The step from which on the load of a slip that begins at a step has been there."""
    first = _step_at(motion, act_s)
    size_n = change_n(motion, first)[first : begin + 1]
    unloaded = np.flatnonzero(size_n <= LOAD_N)
    # A slip of a load that is below LOAD_N begins with itself.
    return min(first + int(unloaded[-1]) + 1, begin) if unloaded.size else first


def _first(flags: BoolArray, start: int = 0, stop: int | None = None) -> int | None:
    """The first step from start up to stop whose flag is set."""
    where = np.flatnonzero(flags[start:stop])
    return start + int(where[0]) if where.size else None
