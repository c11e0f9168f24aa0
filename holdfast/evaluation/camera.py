"""Alarms against a slip as a camera saw it, and against the truth of a simulated scene.

`holdfast onset` writes what a camera saw next to a trial (events.jsonl of a recorded one,
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
from holdfast.evaluation.alarms import AlarmOutcome, EventMatch
from holdfast.evaluation.statistics import Spread, spread
from holdfast.training.recording import Recording

CAMERA = "camera"
KEY = "key"
SCENE = "scene"
"""Provenances of a label: seen by a camera, a key pressed by a person, known from a scene."""
RISKY = SITUATIONS[RISKY_SLIP]
TRUE_START = "incipient_slip"
TRUE_GROSS = "gross_slip"
"""Marks of a scene."""
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


def seen_slips(
    root: Path, recordings: Sequence[Recording]
) -> list[tuple[SeenSlip, ...]]:
    """What a camera saw of every recording of a folder, if anything. Raises LabelError."""
    return [_seen(_csv(root, one.trial_id)) for one in recordings]


def _seen(csv: Path) -> tuple[SeenSlip, ...]:
    # A recorded trial is a folder with its events; a bare CSV has files of its own name.
    if csv.name == TACTILE:
        where = csv.with_name(EVENTS)
        intervals = read_events(where) if where.is_file() else []
        # Its marks stand among the same events.
        marks = _recorded_marks(intervals)
    else:
        where = csv.with_suffix(ONSET_SUFFIX)
        intervals = _phases(read_json(where))
        marks = _truth_marks(read_json(truth_path(csv))) if intervals else []

    slips = []
    for interval in intervals:
        if interval.get("provenance") != CAMERA or interval.get("label") != RISKY:
            continue
        # These files come from outside: a person may have edited them.
        try:
            slips.append(_slip(interval, marks))
        except (KeyError, TypeError, ValueError) as error:
            raise LabelError(
                f"a camera's interval without its times ({error!r:.60})",
                where=where,
                next_step="holdfast onset, again",
            ) from None

    return tuple(slips)


def _phases(content: Json) -> list[Json]:
    phases = content.get("phases", [])
    # An older or hand-written file may hold anything here.
    if not isinstance(phases, list):
        return []
    return [phase for phase in phases if isinstance(phase, dict)]


def _recorded_marks(events: Sequence[Json]) -> list[tuple[str, Any]]:
    """(name, s) of the marks of a scene among the events of a recorded trial."""
    marks = []
    for event in events:
        if event.get("provenance") == SCENE:
            marks.append((str(event.get("mark")), event.get("t_s")))
    return marks


def _truth_marks(truth: Json) -> list[tuple[str, Any]]:
    """(name, s) of the first sliding and the gross slip of every grasp in a scene's truth."""
    marks = []
    # A long stream has a truth with one entry a grasp.
    for grasp in truth.get("trials", [truth]):
        for name in (TRUE_START, TRUE_GROSS):
            marks.append((name, grasp.get(f"{name}_s")))
    return marks


def _slip(interval: Json, marks: Sequence[tuple[str, Any]]) -> SeenSlip:
    """An interval with the scene's marks that fall into it."""
    start_s = float(interval["t0_s"])
    gross_s = float(interval["gross_s"])
    # An object may go on sliding after the gross distance was reached.
    last_s = max(gross_s, float(interval["t1_s"]))
    sd_s = float(interval["uncertainty_s"])

    near = {}
    for name, at_s in marks:
        # A scene writes null for what did not happen.
        if at_s is None:
            continue
        # Both are measured on the same axis, the seconds since the first sample.
        if start_s - LATE_S <= float(at_s) <= last_s + LATE_S:
            near[name] = float(at_s)

    return SeenSlip(
        start_s=start_s,
        sd_s=sd_s,
        gross_s=gross_s,
        true_start_s=near.get(TRUE_START),
        true_gross_s=near.get(TRUE_GROSS),
    )


def onsets_by(root: Path, recordings: Sequence[Recording]) -> dict[str, int]:
    """Provenance (scene, camera, key) -> number of risky events whose onset it gave."""
    count: Counter[str] = Counter()
    for recording in recordings:
        truth = read_json(truth_path(_csv(root, recording.trial_id)))
        for phase in _phases(truth):
            # Older truths do not name what gave a label.
            if phase.get("label") == RISKY and "provenance" in phase:
                count[str(phase["provenance"])] += 1
    return dict(sorted(count.items()))


def onsets_in_words(by: dict[str, int]) -> str:
    """What gave the load onsets, where a camera or a person did; "" for a scene or a script."""
    # A scene and a script know their onsets exactly, and need no such note.
    if not by.keys() & {CAMERA, KEY}:
        return ""
    parts = [f"{name} {count}" for name, count in by.items()]
    counts = ", ".join(parts)
    return (
        f"source of load onsets: {counts}; a camera gives the object's first motion, a pressed key "
        "is late"
    )


def _csv(root: Path, trial_id: str) -> Path:
    """The CSV of a trial: tactile.csv in its folder (or in the root itself), or trial_n.csv."""
    # One recorded trial may be given by itself, and is then the root.
    for folder in (root, root / trial_id):
        if (folder / TACTILE).is_file():
            return folder / TACTILE
    return root / f"{trial_id}.csv"


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
    matched: list[tuple[AlarmOutcome, SeenSlip]] = []
    for stream, slips in zip(streams, seen, strict=True):
        matched += _matched(stream, slips)

    delay_ms = []
    lead_ms = []
    for outcome, slip in matched:
        # A missed slip has no delay; it counts in `events` and not in `found`.
        if outcome.alarm_s is not None:
            delay_ms.append(1e3 * (outcome.alarm_s - slip.start_s))
            lead_ms.append(1e3 * (slip.gross_s - outcome.alarm_s))

    # Also slips that no label calls risky, so that both numbers show how far they agree.
    n_onsets = sum(len(slips) for slips in seen)

    sd_ms = [1e3 * slip.sd_s for _, slip in matched]

    return CameraFigures(
        onsets=n_onsets,
        events=len(matched),
        found=len(delay_ms),
        start_sd_ms=spread(sd_ms),
        delay_ms=spread(delay_ms),
        lead_ms=spread(lead_ms),
        truth=_by_truth(matched),
    )


def _matched(
    stream: EventMatch, slips: Sequence[SeenSlip]
) -> list[tuple[AlarmOutcome, SeenSlip]]:
    """Every event with the first slip that a camera saw begin in it."""
    pairs = []
    for outcome in stream.outcomes:
        first_s = outcome.event.onset_s - LATE_S
        last_s = outcome.event.end_s + LATE_S
        within = [slip for slip in slips if first_s <= slip.start_s <= last_s]
        # A camera may see a second slip in the same event, as the object goes on sliding.
        if within:
            pairs.append((outcome, within[0]))

    return pairs


def _by_truth(matched: Sequence[tuple[AlarmOutcome, SeenSlip]]) -> SceneFigures | None:
    """The times of the scene, of the events of which it knows them; None where it knows none."""
    delay_ms = []
    lead_ms = []
    start_off_ms = []
    gross_off_ms = []
    for outcome, slip in matched:
        alarm_s = outcome.alarm_s
        if slip.true_start_s is not None:
            start_off_ms.append(1e3 * (slip.start_s - slip.true_start_s))
            # A missed event still shows how far the camera is off the scene.
            if alarm_s is not None:
                delay_ms.append(1e3 * (alarm_s - slip.true_start_s))
        if slip.true_gross_s is not None:
            gross_off_ms.append(1e3 * (slip.gross_s - slip.true_gross_s))
            if alarm_s is not None:
                lead_ms.append(1e3 * (slip.true_gross_s - alarm_s))

    if not start_off_ms and not gross_off_ms:
        return None

    return SceneFigures(
        delay_ms=spread(delay_ms),
        lead_ms=spread(lead_ms),
        start_off_ms=spread(start_off_ms),
        gross_off_ms=spread(gross_off_ms),
    )
