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

from holdfast.core.contract import (
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
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


@dataclass(frozen=True)
class _Steps:
    """Steps of a trial's events; None for one that it does not have.

    contact    the first one with contact
    onset      load onset
    incipient  incipient slip
    gross      gross slip
    lost       the first one after the last with contact, which may be one more than there are
    """

    contact: int
    onset: int | None
    incipient: int | None
    gross: int | None
    lost: int

    @staticmethod
    def of(motion: TrialMotion, act_s: float) -> _Steps:
        """From a motion with contact."""
        held = np.flatnonzero(motion.gripped)
        contact = int(held[0])
        lost = int(held[-1]) + 1
        onset = load_onset(motion, act_s)
        if onset is None:
            return _Steps(contact, None, None, None, lost)

        # What slipped while the grip was closing does not count.
        far = slipped_far(motion, onset)
        incipient = _first(motion.slips, onset, lost)
        gross = _first(motion.slides | far, onset, lost)
        return _Steps(contact, onset, incipient, gross, lost)


def slipped_far(motion: TrialMotion, since: int) -> BoolArray:
    """[K] whether the object has slipped or turned so far since a step that it is gross slip."""
    far = motion.slip_m - motion.slip_m[since] >= GROSS_SLIP_M
    if motion.turned_rad is None:
        return far
    turned_rad = motion.turned_rad - motion.turned_rad[since]
    return far | (np.abs(turned_rad) >= GROSS_TURN_RAD)


def truth_of(trial: PlannedTrial, motion: TrialMotion) -> Truth:
    """Read the events of a trial from its steps."""
    # A sample lasts until the next one would come.
    end_s = 2.0 * float(motion.t_s[-1]) - float(motion.t_s[-2])
    everyday = trial.action in ACTION_MODULES
    if everyday and not trial.holds_object:
        touched: Truth = action_module(trial.action).touch_truth(motion)
        return touched
    if not motion.gripped.any():
        return Truth(None, None, None, None, None, 0.0, ((0.0, NOTHING),), end_s)

    times = Times.of(trial)
    if everyday:
        steps, marks = _everyday(trial, motion, times)
    else:
        steps = _Steps.of(motion, times.act)
        marks = _marks(trial, motion, times, steps)
        if "used" in trial.drawn and _ends_before(motion, steps.lost, times.act):
            marks = _failed(motion, steps)

    at_last_m = motion.slip_m[steps.lost - 1]
    at_first_m = motion.slip_m[steps.contact]
    slip_m = at_last_m - at_first_m
    return Truth(
        contact_s=_time(motion, steps.contact),
        load_onset_s=_time(motion, steps.onset),
        incipient_slip_s=_time(motion, steps.incipient),
        gross_slip_s=_time(motion, steps.gross),
        contact_lost_s=_time(motion, steps.lost),
        slip_mm=1e3 * float(slip_m),
        marks=tuple(marks),
        end_s=end_s,
    )


def _time(motion: TrialMotion, step: int | None) -> float | None:
    """The time of a step, s; None for none, and for one after the last."""
    if step is None or step >= len(motion.at_s):
        return None
    return float(motion.at_s[step])


def load_onset(motion: TrialMotion, act_s: float) -> int | None:
    """The step at which the force of people and box has changed by LOAD_N; None: never."""
    first = int(np.searchsorted(motion.at_s, act_s))
    if first >= len(motion.at_s):
        return None
    # Compared with the last step before the action.
    before_n = motion.agents_n[max(first - 1, 0)]
    change = motion.agents_n - before_n
    size_n = np.sqrt((change * change).sum(axis=1))
    return _first(size_n > LOAD_N, first)


def _marks(
    trial: PlannedTrial, motion: TrialMotion, times: Times, steps: _Steps
) -> list[Mark]:
    """The situations of a trial, each from its start."""
    at_s = motion.at_s
    onset = steps.onset
    lost = steps.lost
    # An object that is never lost leaves the hand with the last step.
    last = min(lost, len(at_s) - 1)
    gone = (float(at_s[last]), NOTHING)
    marks: list[Mark] = [(0.0, NOTHING), (float(at_s[steps.contact]), GRASP)]
    if trial.action == "hold":
        return [*marks, *_perturbed(motion, times, lost), gone]
    if onset is None or onset >= lost:
        return [*marks, gone]
    if trial.action in RISKY_ACTIONS:
        # A pull or a fall that the grip withstands stays a grasp.
        if steps.gross is not None:
            marks.append((float(at_s[onset]), RISKY_SLIP))
        return [*marks, gone]

    # A hand-over: safe while the weight goes over, and again when the hand opens.
    marks.append((float(at_s[onset]), SAFE_SLIP))
    transferred = _transferred(trial, motion, times, onset)
    if transferred is not None and transferred < times.open:
        marks.append((transferred, GRASP))
        marks.append((float(times.open), SAFE_SLIP))

    # The taker may have the object before the hand opens.
    before_gone = [mark for mark in marks if mark[0] < gone[0]]
    return [*before_gone, gone]


def _ends_before(motion: TrialMotion, lost: int, act_s: float) -> bool:
    """Whether the last contact ends before the action begins."""
    return lost < len(motion.at_s) and float(motion.at_s[lost]) < act_s


def _failed(motion: TrialMotion, steps: _Steps) -> list[Mark]:
    """A hold that fails by itself, in a scene that draws the friction used: a slip to its end."""
    at_s = motion.at_s
    sliding = steps.contact + np.flatnonzero(motion.slips[steps.contact : steps.lost])
    pauses = np.flatnonzero(np.diff(at_s[sliding]) > PAUSE_S)
    # The slip that loses the object is the last one.
    first = int(pauses[-1]) + 1 if pauses.size else 0
    begin = int(sliding[first]) if sliding.size else steps.lost
    held: list[Mark] = [(0.0, NOTHING), (float(at_s[steps.contact]), GRASP)]
    gone = float(at_s[steps.lost])
    return [*held, (float(at_s[begin]), RISKY_SLIP), (gone, NOTHING)]


def _transferred(
    trial: PlannedTrial, motion: TrialMotion, times: Times, onset: int
) -> float | None:
    """Time at which box or waiting taker has taken over the weight; None without such a pause."""
    if trial.action == "pass" and trial.drawn["wait_s"] == 0.0:
        return None

    before_opening = motion.at_s < times.open
    if not before_opening[onset:].any():
        return None

    # Compared with the last step before load onset.
    given = motion.agents_n - motion.agents_n[onset - 1]
    size = np.sqrt((given * given).sum(axis=1))

    # The force that people and box carry in the pause before the hand opens.
    plateau = float(size[before_opening][-1])
    taken = _first(size >= TRANSFERRED * plateau, onset)
    if taken is None:
        return float(motion.at_s[onset])
    return float(motion.at_s[taken])


def _perturbed(motion: TrialMotion, times: Times, lost: int) -> list[Mark]:
    """A disturbed hold: a grasp, unless the object slips 2 mm or is lost before the hand opens."""
    acts = int(np.searchsorted(motion.at_s, times.act))
    opens = int(np.searchsorted(motion.at_s, times.open))
    marks: list[Mark] = []
    stop = min(opens, lost)
    begin = min(acts, len(motion.slip_m) - 1)
    far = slipped_far(motion, begin)

    if _first(far, acts, stop) is not None:
        sliding = acts + np.flatnonzero(motion.slips[acts:stop])
        if not sliding.size:
            # It has turned with the skin, which slides nowhere.
            sliding = acts + np.flatnonzero(far[acts:stop])
        marks.append((float(motion.at_s[sliding[0]]), RISKY_SLIP))
        if lost > opens:
            # A slip that ends before the hand opens ends as a grasp.
            marks.append((float(motion.at_s[sliding[-1]]), GRASP))
    if lost > opens:
        marks.append((float(times.open), SAFE_SLIP))

    return marks


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
    at_s = motion.at_s
    acts = int(np.searchsorted(at_s, times.act))
    stop = min(int(np.searchsorted(at_s, times.open)), lost)
    sliding = acts + np.flatnonzero(motion.slips[acts:stop])
    if not sliding.size:
        return []

    # Steps that slide, cut where a longer pause is between two of them.
    pauses = np.flatnonzero(np.diff(at_s[sliding]) > PAUSE_S) + 1
    slips = []
    for part in np.split(sliding, pauses):
        begin = int(part[0])
        end = int(part[-1]) + 1

        # Travel counts from the begin of this slip, not from that of the action.
        far = slipped_far(motion, begin)
        gross = _first((motion.slides | far)[begin:end])
        # Elements that creep while the others hold move nothing.
        if gross is not None:
            slips.append((begin, begin + gross, end))

    return slips


def _everyday(
    trial: PlannedTrial, motion: TrialMotion, times: Times
) -> tuple[_Steps, list[Mark]]:
    """Steps and marks of an everyday action that had contact."""
    at_s = motion.at_s
    held = np.flatnonzero(motion.gripped)
    contact = int(held[0])
    lost = int(held[-1]) + 1
    last = min(lost, len(at_s) - 1)
    loaded = trial.action in action_module(trial.action).LOADED
    onset = slip_onset(trial, motion) if loaded else None

    # Held, then every slip, and held again where the object stays in the hand.
    marks: list[Mark] = [(0.0, NOTHING), (float(at_s[contact]), GRASP)]
    slips = _slips(motion, times, lost)
    ended = contact
    for begin, _, end in slips:
        start = _loaded_from(motion, times.act, begin) if loaded else begin
        if start > ended:
            marks.append((float(at_s[start]), RISKY_SLIP))
        else:
            # The load of the slip before is still there: both are one.
            marks.pop()
        ended = end
        # A slip that lasts until the hand opens ends with the opening.
        if end < lost and at_s[end] < times.open:
            marks.append((float(at_s[end]), GRASP))

    # An object that is still there is handed to a person as the hand opens.
    if lost < len(at_s) and at_s[lost] < times.open:
        gone = float(at_s[lost])
    else:
        marks.append((float(times.open), SAFE_SLIP))
        gone = float(at_s[last])

    # The events are those of the first slip.
    incipient = slips[0][0] if slips else None
    gross = slips[0][1] if slips else None
    steps = _Steps(contact, onset, incipient, gross, lost)
    return steps, [*marks, (gone, NOTHING)]


def _loaded_from(motion: TrialMotion, act_s: float, begin: int) -> int:
    """The step from which on the load of a slip that begins at a step has been there."""
    first = int(np.searchsorted(motion.at_s, act_s))
    before_n = motion.agents_n[max(first - 1, 0)]
    change = motion.agents_n[first : begin + 1] - before_n
    size_n = np.sqrt((change * change).sum(axis=1))
    unloaded = np.flatnonzero(size_n <= LOAD_N)
    # A slip of a load that is below LOAD_N begins with itself.
    return min(first + int(unloaded[-1]) + 1, begin) if unloaded.size else first


def _first(flags: BoolArray, start: int = 0, stop: int | None = None) -> int | None:
    """The first step from start up to stop whose flag is set."""
    where = np.flatnonzero(flags[start:stop])
    return start + int(where[0]) if where.size else None
