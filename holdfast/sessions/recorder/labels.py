"""From the marks and intervals of events.jsonl to the phases in tactile.truth.json.

Where several sources have a time for an event, the first of PROVENANCES counts: a scene's own
truth, a camera, a key that the operator pressed (late by about 0.2 s), and a rule that reads from
the normal forces when the hand closed and when it was empty again. Nothing else is guessed: without
a load onset the grip has no label. The file is derived; `holdfast watch --onset` writes it again.

The truth of a scene becomes events of the recorded trial here, too.
"""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from holdfast.core.contract import NORMAL_AXIS, NORMAL_FLOOR, SITUATIONS, Json
from holdfast.core.errors import LabelError
from holdfast.core.hand_card import hand_card_near
from holdfast.core.source import Source
from holdfast.core.trial_file import Trial, read_trial
from holdfast.core.trial_layout import (
    CONTACT_SMOOTH_S,
    EVENTS,
    HELD_ACTIONS,
    META,
    SITUATION_OF_ACTION,
    TACTILE,
    TRUTH,
    contact_rows,
    read_events,
    read_json,
)
from holdfast.core.writing import write_whole

NOTHING = SITUATIONS[0]
"""The situation of an empty hand."""
PROVENANCES = ("scene", "camera", "key", "rule")
"""Sources of a time, the most trusted first."""
BY = "holdfast record"
"""Who wrote an event."""
MARKS = ("contact", "load_onset", "incipient_slip", "gross_slip", "contact_lost")
"""Names of events in the order in which a slip goes through them."""
BIAS_ROWS = 5
"""Valid readings at the start of a trial that give a finger's bias."""


@dataclass(frozen=True)
class LabelledInterval:
    """A phase of a trial, s from the first sample. provenance: one of PROVENANCES."""

    t0_s: float
    t1_s: float
    label: str
    provenance: str


@dataclass(frozen=True)
class TrialTruth:
    """What tactile.truth.json holds. marks: name of MARKS -> s from the first sample, or None."""

    phases: tuple[LabelledInterval, ...]
    marks: dict[str, float | None]

    def to_json(self) -> Json:
        """The labels in the form in which training reads them."""
        marks = {f"{name}_s": at_s for name, at_s in self.marks.items()}
        phases = [asdict(one) for one in self.phases]
        return {"phases": phases, **marks, "by": BY}

    def is_complete(self, action: str) -> bool:
        """Whether the hand closed and was then empty for longer than CONTACT_SMOOTH_S.

        Trials of the action nothing always are.
        """
        if action == NOTHING:
            return True
        # A trial whose source broke off in the grip looks complete but for its end.
        if self.marks["contact"] is None or not self.phases:
            return False
        last = self.phases[-1]
        return last.label == NOTHING and last.t1_s - last.t0_s > CONTACT_SMOOTH_S


def relabel(folder: Path) -> TrialTruth:
    """Derive and write tactile.truth.json again; returns it. Raises a DataError or OutputError."""
    truth = truth_in(folder)
    write_truth(folder, truth)
    return truth


def write_truth(folder: Path, truth: TrialTruth) -> None:
    """Write tactile.truth.json of a trial's folder. Raises OutputError."""
    write_whole(folder / TRUTH, json.dumps(truth.to_json(), indent=1) + "\n")


def read_meta(folder: Path) -> Json:
    """meta.json of a folder, empty without one. Raises LabelError."""
    return read_json(folder / META)


def truth_in(folder: Path) -> TrialTruth:
    """The phases and marks of a trial's folder, from its samples and events. Raises a DataError."""
    path = folder / TACTILE
    trial = read_trial(path, hand_card_near(path))
    meta = read_meta(folder)
    events = read_events(folder / EVENTS)
    phases = []
    try:
        known = _known_marks(events)
        for event in events:
            # Only a scene knows every phase; all other sources give single times.
            if event.get("provenance") == "scene" and event.get("label"):
                t0_s, t1_s = float(event["t0_s"]), float(event["t1_s"])
                phases.append(_interval(t0_s, t1_s, event["label"], "scene"))
    except (KeyError, TypeError, ValueError, OverflowError) as error:
        raise LabelError(
            f"an event without its times ({error!r:.60})",
            where=folder / EVENTS,
            next_step="correct that line",
        ) from None

    # The rule is the least trusted source: it only fills in what no other source gave.
    for name, at_s in _contact(trial, str(meta.get("unit", "N"))).items():
        known.setdefault(name, (at_s, "rule"))
    if not phases:
        # The last sample lasts for a period, so that phases cover the trial.
        end_s = float(trial.t_s[-1]) + 1.0 / trial.rate_hz
        phases = _phases(str(meta.get("action")), end_s, known)

    marks: dict[str, float | None] = dict.fromkeys(MARKS)
    for name, (at_s, _) in known.items():
        marks[name] = round(at_s, 6)
    return TrialTruth(tuple(phases), marks)


def _interval(
    t0_s: float, t1_s: float, label: str, provenance: str
) -> LabelledInterval:
    """Rounded to microseconds, and never ending before it begins."""
    # A key may be pressed out of order; a phase then is empty, not negative.
    end_s = round(max(t0_s, t1_s), 6)
    return LabelledInterval(round(t0_s, 6), end_s, label, provenance)


def _known_marks(events: list[Json]) -> dict[str, tuple[float, str]]:
    """Mark -> (time in s, provenance), from the best source; the first press of a key counts."""
    known: dict[str, tuple[float, str]] = {}
    for provenance in PROVENANCES:
        for event in events:
            if event.get("provenance") != provenance:
                continue
            times = {}
            if event.get("mark") in MARKS:
                times[event["mark"]] = event["t_s"]
            elif provenance == "camera" and "gross_s" in event:
                # A camera writes an interval, from the first sliding to gross slip.
                times["incipient_slip"] = event["t0_s"]
                times["gross_slip"] = event["gross_s"]
            for name, t_s in times.items():
                known.setdefault(name, (float(t_s), provenance))
    return known


def _phases(
    action: str, end_s: float, known: dict[str, tuple[float, str]]
) -> list[LabelledInterval]:
    if action == NOTHING:
        return [_interval(0.0, end_s, NOTHING, "rule")]
    # Without both ends of the grip no phase has a length, so the trial has no label.
    if "contact" not in known or "contact_lost" not in known:
        return []

    closed_s, by_closed = known["contact"]
    empty_s, by_empty = known["contact_lost"]
    phases = [_interval(0.0, closed_s, NOTHING, by_closed)]
    # A camera sees the first sliding, which comes after the load; a key may mark the load itself.
    slip = known.get("load_onset") or known.get("incipient_slip")
    if action in HELD_ACTIONS:
        phases.append(_interval(closed_s, empty_s, "grasp", by_closed))
    elif slip is not None and closed_s < slip[0] < empty_s:
        # A mark outside the grip is a slip of the finger, not of the object.
        slip_s, by_slip = slip
        situation = SITUATION_OF_ACTION[action]
        phases.append(_interval(closed_s, slip_s, "grasp", by_closed))
        phases.append(_interval(slip_s, empty_s, situation, by_slip))
    return [*phases, _interval(empty_s, end_s, NOTHING, by_empty)]


def _contact(trial: Trial, unit: str) -> dict[str, float]:
    """Times at which the hand closed and was empty again; empty where it did not."""
    normal = trial.raw[:, NORMAL_AXIS::3]
    normal = np.where(trial.valid, normal, np.nan)
    bias = np.zeros(normal.shape[1])
    for finger, column in enumerate(normal.T):
        # A trial begins with an open hand, so its first readings are the bias of that moment.
        first = column[np.isfinite(column)][:BIAS_ROWS]
        if first.size:
            bias[finger] = first.mean()
    # A finger that is lost adds nothing to the load of the others.
    load = np.abs(np.nan_to_num(normal - bias)).sum(axis=1)

    floor = NORMAL_FLOOR.get(unit, 0.0)  # type: ignore[call-overload]
    # The rule is that of training, so a label means the same in recorded and read trials.
    rows = contact_rows(load, trial.rate_hz, floor)
    if rows is None:
        return {}
    first_row, stop = rows
    # `stop` is the row after the grip; where the trial ends in it, there is none.
    stop = min(stop, len(trial.t_s) - 1)
    return {
        "contact": float(trial.t_s[first_row]),
        "contact_lost": float(trial.t_s[stop]),
    }


TruthEvents = Callable[[int, int], list[Json]]
"""(time of the first sample, time of the last), ns -> events."""


def scene_truth_of(url: str, source: Source) -> TruthEvents | None:
    """A function for the events of a trial of a scene; None for another source."""
    if not url.startswith(("sim://", "virtual://")):
        return None
    # late: only these need the physics
    from holdfast.live.scene import scene_truth
    from holdfast.live.sources import source_url

    truth = scene_truth(source_url(url))
    if truth is None:
        return None
    # A virtual hand's scene began before the trial; a replayed one begins with it.
    began_ns = getattr(source, "began_ns", None)

    def events(first_ns: int, last_ns: int) -> list[Json]:
        shift_s = 0.0 if began_ns is None else 1e-9 * (began_ns - first_ns)
        return _events(truth.to_json(shift_s), 1e-9 * (last_ns - first_ns))

    return events


def _events(truth: Json, end_s: float) -> list[Json]:
    """Phases and marks between the first sample and the last, at end_s."""
    by = {"provenance": "scene", "by": BY}
    events = []
    for phase in truth["phases"]:
        # The operator may begin late or end early: what lies outside was not recorded.
        if phase["t1_s"] > 0.0 and phase["t0_s"] < end_s:
            t0_s = max(0.0, phase["t0_s"])
            t1_s = min(end_s, phase["t1_s"])
            events.append({"t0_s": t0_s, "t1_s": t1_s, "label": phase["label"], **by})
    for name in MARKS:
        t_s = truth[f"{name}_s"]
        if t_s is not None and 0.0 <= t_s <= end_s:
            events.append({"t_s": t_s, "mark": name, **by})
    return events
