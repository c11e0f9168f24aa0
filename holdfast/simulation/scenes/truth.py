"""The truth of a trial, events and phases, from the solver's own state, never from a sensor.

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
from holdfast.simulation.actions import EVERYDAY, action_named
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.script_times import CATCH_S, Times
from holdfast.simulation.scenes.stepper import TrialMotion

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
    """Times of the events in s, None for one that never happened; end_s: of the trial.

    slip_mm: travel of the contacts from the first contact to the last. marks: (start in s,
    situation), in order, until end_s.
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
            if stop_s <= start_s:
                continue
            start_s += shift_s
            stop_s += shift_s
            phases.append(
                {
                    "t0_s": round(start_s, 6),
                    "t1_s": round(stop_s, 6),
                    "onset_s": round(start_s, 6),
                    "duration_s": round(stop_s - start_s, 6),
                    "label": SITUATIONS[situation],
                    "provenance": PROVENANCE,
                }
            )

        found: Json = {"phases": phases}
        for name in EVENTS:
            at_s = vars(self)[name]
            found[name] = None if at_s is None else round(at_s + shift_s, 6)

        return found | {"slip_mm": round(self.slip_mm, 4)}


class Steps:
    """The steps of a trial, those of its events (None for one it does not have), and its marks.

    at_s       [K] times of the steps
    times      when people and hand act
    everyday   the action is an everyday one
    contact    the first step with contact
    lost       the first one after the last with contact, which may be one more than there are
    onset      load onset
    incipient  incipient slip
    gross      gross slip
    marks      situations from their starts on
    """

    def __init__(self, trial: PlannedTrial, motion: TrialMotion) -> None:
        self.trial = trial
        self.motion = motion
        self.at_s = motion.at_s
        self.times = Times.of(trial)
        self.everyday = trial.action in EVERYDAY
        held = np.flatnonzero(motion.gripped)
        self.contact = int(held[0]) if held.size else 0
        self.lost = int(held[-1]) + 1 if held.size else 0
        self.onset: int | None = None
        self.incipient: int | None = None
        self.gross: int | None = None
        self.marks: list[Mark] = [(0.0, NOTHING)]

    def mark(self, step: int, situation: int) -> None:
        """A situation begins at a step."""
        self.marks.append((float(self.at_s[step]), situation))

    @property
    def gone_s(self) -> float:
        """When the object leaves the hand: one that is never lost with the last step."""
        return float(self.at_s[min(self.lost, len(self.at_s) - 1)])

    def time(self, step: int | None) -> float | None:
        """The time of a step, s; None for none, and for one after the last."""
        if step is None or step >= len(self.at_s):
            return None
        return float(self.at_s[step])

    def at(self, at_s: float) -> int:
        """The first step at or after a time; one more than there are where none is."""
        return int(np.searchsorted(self.at_s, at_s))

    def change_n(self, since: int) -> FloatArray:
        """[K] change of the force of people and box, N, since the step before a step."""
        agents_n = self.motion.agents_n
        change = agents_n - agents_n[max(since - 1, 0)]
        size_n: FloatArray = np.sqrt((change * change).sum(axis=1))
        return size_n

    def load_onset(self) -> int | None:
        """The step at which the force of people and box has changed by LOAD_N; None: never."""
        first = self.at(self.times.act)
        return first_of(self.change_n(first) > LOAD_N, first)

    def slipped_far(self, since: int) -> BoolArray:
        """[K] whether the object has slipped or turned far enough since a step for gross slip."""
        motion = self.motion
        far = motion.slip_m - motion.slip_m[since] >= GROSS_SLIP_M
        turned_rad = motion.turned_rad - motion.turned_rad[since]
        return far | (np.abs(turned_rad) >= GROSS_TURN_RAD)

    def gross_since(self, since: int, stop: int) -> int | None:
        """The step of gross slip, of those from `since` up to stop."""
        slides = self.motion.slides | self.slipped_far(since)
        return first_of(slides, since, stop)

    def find_events(self) -> None:
        """Load onset, and the slip since then: what slipped as the grip closed does not count."""
        self.onset = self.load_onset()
        if self.onset is not None:
            self.incipient = first_of(self.motion.slips, self.onset, self.lost)
            self.gross = self.gross_since(self.onset, self.lost)

    def stretches(self, start: int, stop: int) -> list[Stretch]:
        """The steps from start up to stop that slide, cut where a longer pause is between two."""
        sliding = start + np.flatnonzero(self.motion.slips[start:stop])
        pauses = np.flatnonzero(np.diff(self.at_s[sliding]) > PAUSE_S) + 1
        return np.split(sliding, pauses) if sliding.size else []

    def slips(self) -> list[tuple[int, int, int]]:
        """(begin, gross slip, end) of each slip of an everyday action, numbers of steps."""
        slips = []
        stop = min(self.at(self.times.open), self.lost)
        for part in self.stretches(self.at(self.times.act), stop):
            begin = int(part[0])
            end = int(part[-1]) + 1
            # Travel counts from the begin of this slip, not from that of the action.
            gross = self.gross_since(begin, end)
            # Elements that creep while the others hold move nothing.
            if gross is not None:
                slips.append((begin, gross, end))
        return slips

    def slip_onset(self) -> int | None:
        """The step at which an action begins to endanger the grip; None where it does not.

        It is the load onset where a load comes from outside, else the begin of the first slip.
        """
        if not action_named(self.trial.action).loaded:
            slips = self.slips()
            return slips[0][0] if slips else None
        onset = self.load_onset()
        if not self.everyday or onset is None:
            return onset
        # The person who takes the object at the end is no load of the action.
        return onset if self.at_s[onset] < self.times.open - CATCH_S else None

    def mark_failure(self) -> bool:
        """Mark a hold that fails by itself, in a scene that draws the friction used."""
        lost_early = self.gone_s < self.times.act and self.lost < len(self.at_s)
        if self.everyday or not lost_early or "used" not in self.trial.drawn:
            return False
        # The slip that loses the object is the last one.
        stretches = self.stretches(self.contact, self.lost)
        self.mark(stretches[-1][0] if stretches else self.lost, RISKY_SLIP)
        return True


def truth_of(trial: PlannedTrial, motion: TrialMotion) -> Truth:
    """Read the events of a trial from its steps."""
    # A sample lasts until the next one would come.
    end_s = 2.0 * float(motion.t_s[-1]) - float(motion.t_s[-2])
    action = action_named(trial.action)
    if action.touch_truth is not None:
        touched: Truth = action.touch_truth(motion, end_s)
        return touched
    if not motion.gripped.any():
        return Truth(None, None, None, None, None, 0.0, ((0.0, NOTHING),), end_s)

    steps = Steps(trial, motion)
    steps.mark(steps.contact, GRASP)
    if not steps.everyday:
        steps.find_events()
    if not steps.mark_failure():
        action.mark(steps)

    steps.marks.append((steps.gone_s, NOTHING))
    slip_m = motion.slip_m[steps.lost - 1] - motion.slip_m[steps.contact]
    return Truth(
        contact_s=steps.time(steps.contact),
        load_onset_s=steps.time(steps.onset),
        incipient_slip_s=steps.time(steps.incipient),
        gross_slip_s=steps.time(steps.gross),
        contact_lost_s=steps.time(steps.lost),
        slip_mm=1e3 * float(slip_m),
        marks=tuple(steps.marks),
        end_s=end_s,
    )


def first_of(flags: BoolArray, start: int = 0, stop: int | None = None) -> int | None:
    """The first step from start up to stop whose flag is set."""
    where = np.flatnonzero(flags[start:stop])
    return start + int(where[0]) if where.size else None
