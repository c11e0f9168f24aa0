"""The truth of a trial, events and phases, from the core's own state, never from a sensor.

load onset      after the action begins, the force of people and box changes by LOAD_N
incipient slip  from then on, the first element of any touching brush slides
gross slip      all elements of all touching contacts slide, or the slip since load onset is 2 mm
contact lost    the last contact ends
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.contract import (
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
    FloatArray,
)
from holdfast.core.reading import Json
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.run import TrialMotion
from holdfast.simulation.script import Times

LOAD_N = 0.1
GROSS_SLIP_M = 2e-3
TRANSFERRED = 0.95
"""Share of the final force at which the weight counts as taken over."""
PROVENANCE = "scene"
Mark = tuple[float, int]


@dataclass(frozen=True)
class Truth:
    """Times in s, None for an event that never happened.

    marks: (start in s, situation), in order, until end_s.
    """

    contact_s: float | None
    load_onset_s: float | None
    incipient_slip_s: float | None
    gross_slip_s: float | None
    contact_lost_s: float | None
    slip_mm: float
    marks: tuple[Mark, ...]
    end_s: float

    def to_json(self) -> Json:
        """As in trial_<n>.truth.json: events, and phases as intervals with their provenance."""
        stops = [since for since, _ in self.marks[1:]] + [self.end_s]
        events = (
            "contact_s",
            "load_onset_s",
            "incipient_slip_s",
            "gross_slip_s",
            "contact_lost_s",
        )
        phases = [
            {
                "t0_s": round(t0, 6),
                "t1_s": round(t1, 6),
                "onset_s": round(t0, 6),
                "duration_s": round(t1 - t0, 6),
                "label": SITUATIONS[situation],
                "provenance": PROVENANCE,
            }
            for (t0, situation), t1 in zip(self.marks, stops, strict=True)
            if t1 > t0
        ]
        times = {name: _rounded(getattr(self, name)) for name in events}
        return {"phases": phases, **times, "slip_mm": round(self.slip_mm, 4)}

    def shifted(self, by_s: float) -> Truth:
        """The same truth, later by a time, s."""
        names = (
            "contact_s",
            "load_onset_s",
            "incipient_slip_s",
            "gross_slip_s",
            "contact_lost_s",
        )
        moved = {
            n: None if getattr(self, n) is None else getattr(self, n) + by_s
            for n in names
        }
        marks = tuple((since + by_s, situation) for since, situation in self.marks)
        return Truth(
            **moved, slip_mm=self.slip_mm, marks=marks, end_s=self.end_s + by_s
        )


def truth_of(trial: PlannedTrial, motion: TrialMotion, *, acted: bool = False) -> Truth:
    """Read the events of a trial from its steps.

    acted: the hand had a controller; then a slip that it stopped ends as a grasp.
    """
    end_s = 2.0 * float(motion.t_s[-1]) - float(motion.t_s[-2])
    held = np.flatnonzero(motion.gripped)
    if not held.size:
        return Truth(None, None, None, None, None, 0.0, ((0.0, NOTHING),), end_s)
    times = Times.of(trial)
    contact, lost = held[0], held[-1] + 1
    onset = load_onset(motion, times.act)
    since = np.arange(len(motion.at_s)) >= (
        len(motion.at_s) if onset is None else onset
    )
    since[lost:] = False
    incipient = _first(motion.slips & since)
    gross = _first(
        (motion.slides | (motion.slip_m - motion.slip_m[onset or 0] >= GROSS_SLIP_M))
        & since
    )
    at = _clock(motion, len(motion.at_s) if lost >= len(motion.at_s) else None)
    marks = _marks(trial, motion, times, contact, onset, gross, lost)
    if acted:
        marks = _stopped(marks, motion, lost)
    return Truth(
        at(contact),
        at(onset),
        at(incipient),
        at(gross),
        at(lost),
        slip_mm=1e3 * float(motion.slip_m[lost - 1] - motion.slip_m[contact]),
        marks=tuple(marks),
        end_s=end_s,
    )


def _clock(motion: TrialMotion, beyond: int | None) -> Any:
    def at(step: int | None) -> float | None:
        return None if step is None or step == beyond else float(motion.at_s[step])

    return at


def load_onset(motion: TrialMotion, act_s: float) -> int | None:
    """The step at which the force of people and box has changed by LOAD_N; None: never."""
    first = int(np.searchsorted(motion.at_s, act_s))
    if first >= len(motion.at_s):
        return None
    change = motion.agents_n[first:] - motion.agents_n[max(first - 1, 0)]
    found = _first(np.sqrt((change * change).sum(axis=1)) > LOAD_N)
    return None if found is None else first + found


def _marks(
    trial: PlannedTrial,
    motion: TrialMotion,
    times: Times,
    contact: int,
    onset: int | None,
    gross: int | None,
    lost: int,
) -> list[Mark]:
    at_s = motion.at_s
    gone = (float(at_s[lost]) if lost < len(at_s) else float(at_s[-1]), NOTHING)
    marks: list[Mark] = [(0.0, NOTHING), (float(at_s[contact]), GRASP)]
    if trial.action == "hold":
        return [*marks, *_perturbed(motion, times, lost), gone]
    if onset is None or onset >= lost:
        return [*marks, gone]
    if trial.action in RISKY_ACTIONS:
        slipped = gross is not None
        return [*marks, *([(float(at_s[onset]), RISKY_SLIP)] if slipped else []), gone]
    marks.append((float(at_s[onset]), SAFE_SLIP))
    transferred = _transferred(trial, motion, times, onset)
    if transferred is not None and transferred < times.open:
        marks += [(transferred, GRASP), (max(times.open, transferred), SAFE_SLIP)]
    return [*[mark for mark in marks if mark[0] < gone[0]], gone]


def _stopped(marks: list[Mark], motion: TrialMotion, lost: int) -> list[Mark]:
    """The marks, and a grasp from the last slip on where the object stays in the hand."""
    slips = np.flatnonzero(motion.slips)
    stays = lost >= len(motion.at_s) and marks[-2][1] == RISKY_SLIP
    if not stays or slips[-1] + 1 >= len(motion.at_s):
        return marks
    return [*marks[:-1], (float(motion.at_s[slips[-1] + 1]), GRASP), marks[-1]]


def _transferred(
    trial: PlannedTrial, motion: TrialMotion, times: Times, onset: int
) -> float | None:
    """Time at which box or waiting taker has taken over the weight; None without such a pause."""
    if trial.action == "pass" and trial.drawn["wait_s"] == 0.0:
        return None
    before_opening = motion.at_s < times.open
    if not before_opening[onset:].any():
        return None
    given = motion.agents_n - motion.agents_n[onset - 1]
    size = np.sqrt((given * given).sum(axis=1))
    plateau = float(size[before_opening][-1])
    return float(
        motion.at_s[onset + (_first(size[onset:] >= TRANSFERRED * plateau) or 0)]
    )


def _perturbed(motion: TrialMotion, times: Times, lost: int) -> list[Mark]:
    """A disturbed hold: a grasp, unless the object slips 2 mm or is lost before the hand opens."""
    acts, opens = (
        int(np.searchsorted(motion.at_s, t)) for t in (times.act, times.open)
    )
    marks: list[Mark] = []
    within = slice(acts, min(opens, lost))
    slipped = motion.slip_m[within] - motion.slip_m[min(acts, len(motion.slip_m) - 1)]
    gross = _first(slipped >= GROSS_SLIP_M)
    if gross is not None:
        start = acts + (_first(motion.slips[within]) or 0)
        sliding = np.flatnonzero(motion.slips[within])
        marks.append((float(motion.at_s[start]), RISKY_SLIP))
        if lost > opens:
            marks.append((float(motion.at_s[acts + sliding[-1]]), GRASP))
    return [*marks, (float(times.open), SAFE_SLIP)] if lost > opens else marks


def _first(found: BoolArray | FloatArray) -> int | None:
    where = np.flatnonzero(found)
    return int(where[0]) if where.size else None


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 6)
