"""The phases of a trial: from its truth file, else from the script it followed.

A `daily` (many grasps in a row) follows no script: it needs its truth. So does an everyday action.
A `hold` (disturbed, but kept) and a `slip` do without: see `of_whole_trial`; so does a `lift`, or
many of them one after the other (lifts.py).

The script (s): nothing, grasp, hold until 7, the action from 7. A put-down, and the hand-over of
the full bottle, act in [7, 10) and release from 10. Then nothing. Where "action_at_s" gives another
start of the action, the times after it move along. The script does not contain contact: the normal
forces give when the hand closes, and when it is empty again.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Annotated, Literal

import msgspec
import numpy as np

from holdfast.core.contract import (
    GRASP,
    NORMAL_AXIS,
    NOTHING,
    RISKY_SLIP,
    SITUATIONS,
    FloatArray,
)
from holdfast.core.errors import LabelError
from holdfast.core.schema import checked
from holdfast.core.trial_file import LONGEST_S, Trial
from holdfast.core.trial_layout import (
    LABELLED_ACTIONS,
    SITUATION_OF_ACTION,
    UNSCRIPTED,
    contact_rows,
    read_json,
    truth_path,
)

ACTION_S = 7.0
"""When the thesis' script starts the action, from the first row."""
HOLD_AGAIN_S = 2.0
"""After the action's start: a put-down holds again in its last second before the release.

The thesis' script gives no time for it."""
RELEASE_S = 3.0
"""After the action's start."""
CHANGE_S = 0.1
"""Over this time the largest change of a slip is measured."""
CLOSING_S = 0.3
"""After the hand has closed, while the readings change because it closes."""
SLIP_BEFORE_S, SLIP_AFTER_S = 0.1, 0.3
"""What counts as slip before and after the largest change."""
ACTION_KEY = "action_at_s"
"""In meta.json of the set or in a trial's truth: when the action starts."""
OF_WHOLE_TRIAL = {
    "hold": "its folder",
    "slip": "its folder, at the largest change",
    "lift": "its folder, by contact",
}
"""What the labels of LABELLED_ACTIONS come from without a truth."""


@dataclass(frozen=True)
class Phase:
    """Rows [first, stop) of a trial in one situation (0..3)."""

    first: int
    stop: int
    situation: int


@dataclass(frozen=True)
class RiskyEvent:
    """A grip that fails, in s from the first sample. gross_s: None where it is not known.

    onset_s: the start of the risky phase. gross_s: when the slip becomes gross. end_s: the end of
    the phase. timed: False where it lies somewhere between the two, so that no delay is known.
    lost: it begins while samples are lost, or while the history is not whole after that.
    """

    onset_s: float
    gross_s: float | None
    end_s: float
    timed: bool = True
    lost: bool = False


Phases = tuple[Phase, ...]
RiskyEvents = tuple[RiskyEvent, ...]


def scripted(
    trial: Trial,
    samples: FloatArray,
    action: str,
    object_name: str,
    action_at_s: float = ACTION_S,
) -> Phases:
    """Phases of a trial that followed the script; samples [T, C] are the trial's, prepared.

    Raises LabelError where the hand is not closed when the action should begin, or where there is
    no script.
    """
    if action in LABELLED_ACTIONS:
        return of_whole_trial(trial.t_s, samples, action)
    if action in UNSCRIPTED:
        raise LabelError(
            f"a {action!r} follows no script, and its truth is missing",
            where=trial.path,
            cause=f"{truth_path(trial.path).name} was not copied along, or never written",
            next_step=f"put {truth_path(trial.path).name} beside it, or move the trial out",
        )

    t_s = trial.t_s
    onset, empty = contact(t_s, samples)

    acts = int(np.searchsorted(t_s, action_at_s))
    if not onset < acts < empty:
        raise LabelError(
            f"the layout expects the action to start at {action_at_s:g} s, but contact lasted from "
            f"{t_s[onset]:.2f} to {t_s[empty - 1]:.2f} s",
            where=trial.path,
            cause="a trial that did not follow the script",
            next_step=f'write {{"{ACTION_KEY}": ..}} to meta.json of the set, or that or its '
            f"phases to {truth_path(trial.path).name}",
        )

    slip = SITUATIONS.index(SITUATION_OF_ACTION[action])
    starts = {0: NOTHING, onset: GRASP, acts: slip}

    # These two actions have two steps: the object is set down or taken, then the hand lets go.
    if action == "put-down" or (action, object_name) == ("pass", "full-bottle"):
        times_s = [action_at_s + HOLD_AGAIN_S, action_at_s + RELEASE_S]
        again, release = np.searchsorted(t_s, times_s).tolist()
        starts |= {again: GRASP, release: slip}
    # A hand that is empty sooner than the script has it skips the rest.
    starts = {row: situation for row, situation in starts.items() if row < empty}
    starts[empty] = NOTHING

    rows = [*starts, len(t_s)]
    phases = zip(rows[:-1], rows[1:], starts.values(), strict=True)
    return tuple(
        Phase(first, stop, what) for first, stop, what in phases if first < stop
    )


def of_whole_trial(t_s: FloatArray, samples: FloatArray, action: str) -> Phases:
    """The one phase of a trial that is labelled hold or slip as a whole; samples [T, C], prepared.

    A hold is a grasp while the hand is closed. A slip lies about the largest change of the readings
    after the hand has closed. All other rows have no label: whether the hand was empty there is not
    known either.
    """
    onset, empty = contact(t_s, samples)
    if action == "hold":
        return (Phase(onset, empty, GRASP),)

    period_s = float(np.median(np.diff(t_s)))
    rows = max(1, round(CHANGE_S / period_s))
    begins = onset + round(CLOSING_S / period_s)
    # A contact this short has no time after the closing.
    if begins + rows >= empty:
        begins = onset
    # A lost value changes nothing.
    change = np.nan_to_num(samples[rows:] - samples[:-rows])
    size = np.sqrt(np.square(change).sum(axis=1))
    after_closing = size[begins : max(begins + 1, empty - rows)]
    if not len(after_closing):
        return (Phase(onset, empty, RISKY_SLIP),)

    # The change lies between a row and the one so many rows later.
    at = begins + int(after_closing.argmax()) + rows // 2
    first = max(onset, at - round(SLIP_BEFORE_S / period_s))
    stop = min(empty, at + round(SLIP_AFTER_S / period_s))
    return (Phase(first, stop, RISKY_SLIP),)


def contact(t_s: FloatArray, samples: FloatArray) -> tuple[int, int]:
    """First row with the hand closed on something, and first row after the last such.

    Closed: the normal forces, summed and averaged over 0.1 s, exceed a tenth of their 95th
    percentile.
    """
    # A lost value counts as no force, so a gap alone never looks like contact.
    load = np.abs(np.nan_to_num(samples[:, NORMAL_AXIS::3])).sum(axis=1)

    # The median step is the sampling period, also where samples are missing.
    rows = contact_rows(load, 1.0 / float(np.median(np.diff(t_s))))
    assert rows is not None  # no load is less than none
    return rows


class _TruthPhase(msgspec.Struct, frozen=True):
    """A phase of a truth file, in s from the first sample; further keys are for people."""

    t0_s: float
    t1_s: float
    label: Literal["nothing", "grasp", "safe_slip", "risky_slip"]
    provenance: str = ""

    def __post_init__(self) -> None:
        if self.t1_s < self.t0_s:
            raise ValueError("a phase ends before it begins; allowed: t0_s <= t1_s")


class _GrossSlip(msgspec.Struct, frozen=True):
    """When all fingers slide, s from the first sample; None where none is known."""

    gross_slip_s: float | None = None


class TruthFile(_GrossSlip, frozen=True):
    """A truth file, or nothing at all where a trial has none.

    phases: None where the file only says when the action starts. trials: of a recording of several,
    each with its gross slip. action_at_s: None where it gives no time.
    """

    phases: list[_TruthPhase] | None = None
    trials: list[_GrossSlip] = []
    action_at_s: Annotated[float, msgspec.Meta(gt=0.0, lt=LONGEST_S)] | None = None

    @property
    def end_s(self) -> float:
        """When the last phase ends, s from the first sample; 0 without any."""
        return max((phase.t1_s for phase in self.phases or []), default=0.0)

    def labels_by(self, action_at_s: float, action: str | None) -> str:
        """What the labels come from: provenances of the phases, the folder, or the script.

        action_at_s: of the set.
        """
        if self.phases is None:
            if action in LABELLED_ACTIONS:
                return OF_WHOLE_TRIAL[action]
            source = " (truth file)" if self.action_at_s else ""
            return f"script, action at {self.action_at_s or action_at_s:g} s{source}"

        names = {phase.provenance or "truth file" for phase in self.phases}
        # A phase that names its provenance tells more than that there is a file.
        if len(names) > 1:
            names.discard("truth file")
        return ", ".join(sorted(names)) or "no label"

    def phases_on(self, t_s: FloatArray, where: Path) -> Phases:
        """The phases in rows of a trial with these times [T]; rows in none have no label.

        Raises LabelError, which names the file `where`, for phases that overlap.
        """
        phases = []
        for entry in self.phases or []:
            first, stop = np.searchsorted(t_s, [entry.t0_s, entry.t1_s]).tolist()
            phases.append(Phase(first, stop, SITUATIONS.index(entry.label)))
        if any(phase.stop > later.first for phase, later in pairwise(phases)):
            raise LabelError(
                "phases overlap or are out of order",
                where=where,
                next_step="correct or remove it",
            )
        # A phase shorter than the time between two samples holds none of them.
        return tuple(phase for phase in phases if phase.first < phase.stop)

    def events(self) -> RiskyEvents:
        """The risky phases, each with the first gross slip that falls into it."""
        events = []
        for entry in self.phases or []:
            if entry.label != SITUATIONS[RISKY_SLIP]:
                continue
            gross_s = None
            for trial in self.trials or [self]:
                at_s = trial.gross_slip_s
                is_within = at_s is not None and entry.t0_s <= at_s <= entry.t1_s
                if gross_s is None and is_within:
                    gross_s = at_s
            events.append(RiskyEvent(entry.t0_s, gross_s, entry.t1_s))
        return tuple(events)


def read_truth(path: Path) -> TruthFile:
    """A truth file: `{"phases": [{"t0_s", "t1_s", "label", "provenance"}, ..]}`; times in s.

    Empty where there is none. Raises LabelError, also for a file without phases that does not say
    when the action starts either.
    """
    raw = read_json(path)
    if path.exists() and not raw.keys() & {"phases", ACTION_KEY}:
        raise LabelError(
            "holds no list of phases", where=path, next_step="correct or remove it"
        )
    return checked(raw, TruthFile, path, LabelError)


def events_of(
    phases: Phases, n_rows: int, rate_hz: float, action: str | None
) -> RiskyEvents:
    """The risky phases of a script, which knows no gross slip.

    The event of a trial that is labelled slip as a whole lies somewhere in it.
    """
    if action == "slip":
        return (RiskyEvent(0.0, None, n_rows / rate_hz, timed=False),)
    events = []
    for phase in phases:
        if phase.situation == RISKY_SLIP:
            onset_s, end_s = phase.first / rate_hz, phase.stop / rate_hz
            events.append(RiskyEvent(onset_s, None, end_s))
    return tuple(events)
