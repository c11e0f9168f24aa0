"""Alarms against a slip as a camera saw it, and against the truth of a simulated scene.

`holdfast onset` writes what a camera saw beside a trial (events.jsonl of a recorded one,
trial_n.onset.json of a bare CSV), with the provenance `camera`; no tactile sample is used for it.
Two of its times count:

start  the object begins to move in the hand (fitted); early where elastic pads move before any slip
gross  the object has moved a fixed distance

Their counterparts in a scene are the first part that slides, and gross slip.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from holdfast.core.contract import RISKY_SLIP, SITUATIONS
from holdfast.core.errors import LabelError
from holdfast.core.reading import Json
from holdfast.core.trial_layout import (
    EVENTS,
    ONSET_SUFFIX,
    TACTILE,
    read_events,
    read_json,
    truth_path,
)
from holdfast.evaluation.event_scores import AlarmOutcome, EventMatch
from holdfast.evaluation.statistics import Spread, spread
from holdfast.training.recording import Recording

CAMERA, KEY, SCENE, RISKY = "camera", "key", "scene", SITUATIONS[RISKY_SLIP]
LATE_S = 0.05
"""A camera's start belongs to the event it falls into, or so much before or after it."""


@dataclass(frozen=True)
class SeenSlip:
    """A risky slip as a camera saw it, times in s from the first sample.

    sd_s: of the start. true_start_s, true_gross_s: of the scene, None where it does not know them.
    """

    start_s: float
    sd_s: float
    gross_s: float
    true_start_s: float | None = None
    true_gross_s: float | None = None


def seen_beside(
    root: Path, recordings: Sequence[Recording]
) -> list[tuple[SeenSlip, ...]]:
    """What a camera saw of every recording of a folder, if anything. Raises LabelError."""
    return [_seen(root, one.trial_id) for one in recordings]


def _seen(root: Path, trial_id: str) -> tuple[SeenSlip, ...]:
    csv = _beside(root, trial_id)
    where = (
        csv.with_name(EVENTS) if csv.name == TACTILE else csv.with_suffix(ONSET_SUFFIX)
    )
    if csv.name == TACTILE:
        entries = read_events(where) if where.is_file() else []
        scene = [one for one in entries if one.get("provenance") == SCENE]
        marks = [(str(one.get("mark")), one.get("t_s")) for one in scene]
    else:
        phases = read_json(where).get("phases", [])
        phases = phases if isinstance(phases, list) else []
        entries = [one for one in phases if isinstance(one, dict)]
        marks = _truth_marks(read_json(truth_path(csv))) if entries else []
    try:
        return tuple(
            _one(interval, marks) for interval in entries if _is_risky(interval)
        )
    except (KeyError, TypeError, ValueError) as error:
        raise LabelError(
            f"a camera's interval without its times ({error!r:.60})",
            where=where,
            next_step="holdfast onset, again",
        ) from None


def onsets_by(root: Path, recordings: Sequence[Recording]) -> dict[str, int]:
    """Provenance (scene, camera, key) -> number of risky events whose onset it gave."""
    truths = [read_json(truth_path(_beside(root, one.trial_id))) for one in recordings]
    phases = [
        phase
        for truth in truths
        for phase in truth.get("phases", [])
        if isinstance(phase, dict)
    ]
    provenances = [
        str(phase["provenance"])
        for phase in phases
        if phase.get("label") == RISKY and "provenance" in phase
    ]
    return dict(sorted(Counter(provenances).items()))


def onsets_in_words(by: dict[str, int]) -> str:
    """What gave the load onsets, where a camera or a person did; "" for a scene or a script."""
    if not by.keys() & {CAMERA, KEY}:
        return ""
    counts = ", ".join(f"{name} {count}" for name, count in by.items())
    return (
        f"source of load onsets: {counts}; a camera gives the object's first motion, a pressed key "
        "is late"
    )


def _beside(root: Path, trial_id: str) -> Path:
    """The CSV of a trial: tactile.csv in its folder (or in the root itself), or trial_n.csv."""
    folders = (root, root / trial_id)
    return next(
        (one / TACTILE for one in folders if (one / TACTILE).is_file()),
        root / f"{trial_id}.csv",
    )


def _is_risky(interval: Json) -> bool:
    return interval.get("provenance") == CAMERA and interval.get("label") == RISKY


def _truth_marks(truth: Json) -> list[tuple[str, Any]]:
    """(name, s) of the first sliding and the gross slip of every grasp in a scene's truth."""
    trials = truth.get("trials", [truth])
    return [
        (name, one.get(f"{name}_s"))
        for one in trials
        for name in ("incipient_slip", "gross_slip")
    ]


def _one(interval: Json, marks: Sequence[tuple[str, Any]]) -> SeenSlip:
    start_s, gross_s, end_s = (
        float(interval[name]) for name in ("t0_s", "gross_s", "t1_s")
    )
    near = {
        name: float(at_s)
        for name, at_s in marks
        if at_s is not None
        and start_s - LATE_S <= float(at_s) <= max(gross_s, end_s) + LATE_S
    }
    sd_s = float(interval["uncertainty_s"])
    return SeenSlip(
        start_s, sd_s, gross_s, near.get("incipient_slip"), near.get("gross_slip")
    )


@dataclass(frozen=True)
class SceneFigures:
    """The same times by the truth of a scene; start_off_ms, gross_off_ms: camera minus truth."""

    delay_ms: Spread | None
    lead_ms: Spread | None
    start_off_ms: Spread | None
    gross_off_ms: Spread | None


@dataclass(frozen=True)
class CameraFigures:
    """Alarms against what a camera saw.

    onsets: slips that the camera saw. events: those of them that are risky events of the labels.
    found: those with an alarm. delay_ms: camera's start to alarm. lead_ms: alarm to the camera's
    gross slip. truth: None where no scene knows it.
    """

    onsets: int
    events: int
    found: int
    start_sd_ms: Spread | None
    delay_ms: Spread | None
    lead_ms: Spread | None
    truth: SceneFigures | None


def camera_figures(
    streams: Sequence[EventMatch], seen: Sequence[tuple[SeenSlip, ...]]
) -> CameraFigures | None:
    """Match the alarms of every stream with the slips that a camera saw; None without a slip."""
    if not any(seen):
        return None
    matched = [
        pair
        for stream, slips in zip(streams, seen, strict=True)
        for pair in _matched(stream, slips)
    ]
    found = [
        (outcome.alarm_s, slip)
        for outcome, slip in matched
        if outcome.alarm_s is not None
    ]
    return CameraFigures(
        onsets=sum(len(slips) for slips in seen),
        events=len(matched),
        found=len(found),
        start_sd_ms=spread([1e3 * slip.sd_s for _, slip in matched]),
        delay_ms=spread([1e3 * (alarm_s - slip.start_s) for alarm_s, slip in found]),
        lead_ms=spread([1e3 * (slip.gross_s - alarm_s) for alarm_s, slip in found]),
        truth=_by_truth([slip for _, slip in matched], found),
    )


def _matched(
    stream: EventMatch, slips: Sequence[SeenSlip]
) -> list[tuple[AlarmOutcome, SeenSlip]]:
    """Every event with the slip that a camera saw begin in it."""
    pairs = []
    for outcome in stream.outcomes:
        first_s, last_s = outcome.event.onset_s - LATE_S, outcome.event.end_s + LATE_S
        within = [slip for slip in slips if first_s <= slip.start_s <= last_s]
        pairs += [(outcome, slip) for slip in within[:1]]
    return pairs


def _by_truth(
    matched: Sequence[SeenSlip], found: Sequence[tuple[float, SeenSlip]]
) -> SceneFigures | None:
    if not any(
        slip.true_start_s is not None or slip.true_gross_s is not None
        for slip in matched
    ):
        return None
    starts = [(s, s.true_start_s) for s in matched if s.true_start_s is not None]
    grosses = [(s, s.true_gross_s) for s in matched if s.true_gross_s is not None]
    return SceneFigures(
        spread(
            [1e3 * (a - s.true_start_s) for a, s in found if s.true_start_s is not None]
        ),
        spread(
            [1e3 * (s.true_gross_s - a) for a, s in found if s.true_gross_s is not None]
        ),
        spread([1e3 * (slip.start_s - true_s) for slip, true_s in starts]),
        spread([1e3 * (slip.gross_s - true_s) for slip, true_s in grosses]),
    )
