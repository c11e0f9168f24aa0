"""The truth of a trial, events and phases, from the core's own state, never from a sensor.

load onset      after the action begins, the force of people and box changes by LOAD_N
incipient slip  from then on, the first element of any touching brush slides
gross slip      all elements of all touching contacts slide, or the slip since load onset is 2 mm;
                an object that can turn (effect `rotation`) also slips as a whole once it has turned
                by 15 degrees since, the limit of human_slip_uskin between safe and not
contact lost    the last contact ends

In an everyday action (actions/everyday.py) slips come and go, also without a load from outside. A
slip is a stretch of steps in which elements slide, with pauses of PAUSE_S at most, in which the
object slides as a whole or by 2 mm. It is risky from its load onset, or from its begin where no
load from outside caused it, to its end. Everything else is a grasp until the hand opens.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SITUATIONS,
    BoolArray,
    FloatArray,
    Json,
)
from holdfast.simulation.actions import action_named
from holdfast.simulation.protocol import PlannedTrial
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
class Steps:
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

    def gone_s(self, motion: TrialMotion) -> float:
        """When the object leaves the hand: one that is never lost with the last step."""
        at_s = motion.at_s
        return float(at_s[min(self.lost, len(at_s) - 1)])


def truth_of(trial: PlannedTrial, motion: TrialMotion) -> Truth:
    """Read the events of a trial from its steps."""
    # A sample lasts until the next one would come.
    end_s = 2.0 * float(motion.t_s[-1]) - float(motion.t_s[-2])
    action = action_named(trial.action)
    if action.touch_truth is not None:
        touched: Truth = action.touch_truth(motion)
        return touched
    held = np.flatnonzero(motion.gripped)
    if not held.size:
        return Truth(None, None, None, None, None, 0.0, ((0.0, NOTHING),), end_s)

    at_s = motion.at_s
    times = Times.of(trial)
    steps = Steps(contact=int(held[0]), lost=int(held[-1]) + 1)
    marks: list[Mark] = [(0.0, NOTHING), (at_s[steps.contact], GRASP)]
    if not action.everyday:
        _find_events(motion, times, steps)
    lost_early = steps.lost < len(at_s) and at_s[steps.lost] < times.act
    if "used" in trial.drawn and lost_early and not action.everyday:
        _mark_failure(marks, motion, steps)
    else:
        action.mark(marks, trial, motion, times, steps)

    marks.append((steps.gone_s(motion), NOTHING))
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


def _find_events(motion: TrialMotion, times: Times, steps: Steps) -> None:
    """Load onset, and the slip since then: what slipped while the grip closed does not count."""
    onset = load_onset(motion, times.act)
    steps.onset = onset
    if onset is not None:
        far = slipped_far(motion, onset)
        steps.incipient = first_of(motion.slips, onset, steps.lost)
        steps.gross = first_of(motion.slides | far, onset, steps.lost)


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


def step_at(motion: TrialMotion, at_s: float) -> int:
    """The first step at or after a time; one more than there are where none is."""
    return int(np.searchsorted(motion.at_s, at_s))


def change_n(motion: TrialMotion, since: int) -> FloatArray:
    """[K] size of the change of the force of people and box, N, since the step before a step."""
    change = motion.agents_n - motion.agents_n[max(since - 1, 0)]
    size_n: FloatArray = np.sqrt((change * change).sum(axis=1))
    return size_n


def load_onset(motion: TrialMotion, act_s: float) -> int | None:
    """The step at which the force of people and box has changed by LOAD_N; None: never."""
    first = step_at(motion, act_s)
    return first_of(change_n(motion, first) > LOAD_N, first)


def _stretches(motion: TrialMotion, start: int, stop: int) -> list[Stretch]:
    """The steps from start up to stop that slide, cut where a longer pause is between two."""
    sliding = start + np.flatnonzero(motion.slips[start:stop])
    pauses = np.flatnonzero(np.diff(motion.at_s[sliding]) > PAUSE_S) + 1
    return np.split(sliding, pauses) if sliding.size else []


def _mark_failure(marks: list[Mark], motion: TrialMotion, steps: Steps) -> None:
    """A hold that fails by itself, in a scene that draws the friction used: a slip to its end."""
    # The slip that loses the object is the last one.
    stretches = _stretches(motion, steps.contact, steps.lost)
    begin = stretches[-1][0] if stretches else steps.lost
    marks.append((motion.at_s[begin], RISKY_SLIP))


def slip_onset(trial: PlannedTrial, motion: TrialMotion) -> int | None:
    """The step at which an action begins to endanger the grip; None where it does not.

    It is the load onset where a load comes from outside, else the begin of the first slip.
    """
    times = Times.of(trial)
    action = action_named(trial.action)
    if action.loaded:
        onset = load_onset(motion, times.act)
        if not action.everyday or onset is None:
            return onset
        # The person who takes the object at the end is no load of the action.
        return onset if motion.at_s[onset] < times.open - CATCH_S else None
    held = np.flatnonzero(motion.gripped)
    slips = slips_in(motion, times, int(held[-1]) + 1) if held.size else []
    return slips[0][0] if slips else None


def slips_in(
    motion: TrialMotion, times: Times, lost: int
) -> list[tuple[int, int, int]]:
    """(begin, gross slip, end) of each slip of an everyday action, numbers of steps."""
    slips = []
    stop = min(step_at(motion, times.open), lost)
    for part in _stretches(motion, step_at(motion, times.act), stop):
        begin = int(part[0])
        end = int(part[-1]) + 1

        # Travel counts from the begin of this slip, not from that of the action.
        far = slipped_far(motion, begin)
        gross = first_of(motion.slides | far, begin, end)
        # Elements that creep while the others hold move nothing.
        if gross is not None:
            slips.append((begin, gross, end))

    return slips


def first_of(flags: BoolArray, start: int = 0, stop: int | None = None) -> int | None:
    """The first step from start up to stop whose flag is set."""
    where = np.flatnonzero(flags[start:stop])
    return start + int(where[0]) if where.size else None
