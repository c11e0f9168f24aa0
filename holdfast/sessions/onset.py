"""The label of a slip that a camera saw: found in the object's motion, written beside the trial.

The motion in the hand is read from a watched folder.
"""

from __future__ import annotations

import csv
import json
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.core.errors import (
    DataError,
    DataNotFound,
    EmptyRecording,
    LabelError,
    NotANumber,
    TimeError,
    UsageError,
)
from holdfast.core.trial_layout import (
    EVENTS,
    HELD_ACTIONS,
    RISKY_ACTIONS,
    TACTILE,
    TRUTH,
    VOLUNTARY_ACTIONS,
    read_events,
)
from holdfast.core.writing import write_whole

if TYPE_CHECKING:
    from holdfast.core.contract import Json
    from holdfast.drivers.camera.onset import Motion, Slip

OBJECT_TAG = 0
"""Number of the tag on the object."""
HAND_TAG = 1
"""Number of the tag on the hand, against which the object's motion is measured."""
RISKY = (*RISKY_ACTIONS, *HELD_ACTIONS)
"""In a hold the object must not move at all, so any slip is risky."""
ACTIONS = (*RISKY, *VOLUNTARY_ACTIONS)
PROVENANCE = "camera"
GROSS_MM = 2.0
"""Distance of gross slip, where no other is given."""


@dataclass(frozen=True)
class WatchedTrial:
    """A trial, and the motion that the camera saw.

    starts_s: when the trial's clock begins, on that of the frames.
    """

    path: Path
    moved: Motion
    starts_s: float


def read_motion(folder: Path, tag_mm: float | None = None) -> WatchedTrial:
    """The object's motion in the hand, from a watched folder. Raises a DataError."""
    from holdfast.drivers.camera.onset import motion
    from holdfast.drivers.camera.recording import TAGS, read_about, read_tracks

    if not folder.is_dir():
        raise DataNotFound(
            "no folder of a watched trial",
            where=folder,
            next_step="give a folder of holdfast watch, or of record --camera",
        )
    about = read_about(folder)
    if about.void is not None:
        raise LabelError(
            "the trial is void and gets no label",
            where=folder,
            cause=about.void,
            next_step="record it again",
        )

    tracks = read_tracks(folder)
    # A file that was cut would give a slip that ends too early.
    if len(tracks.t_s) < about.frames:
        raise EmptyRecording(
            f"holds {len(tracks.t_s)} of its {about.frames} frames",
            where=folder / TAGS,
            cause="an interrupted copy, or a broken disk",
            next_step="copy it again from where it was recorded",
        )

    with _placed(folder):
        moved = motion(
            tracks.t_s,
            tracks.of(OBJECT_TAG),
            tracks.of(HAND_TAG),
            tag_mm or about.tag_mm,
        )
    starts_s = 0.0 if about.clock == "trial" else _starts_s(folder, moved)
    return WatchedTrial(folder, moved, starts_s)


@contextmanager
def _placed(trial: Path) -> Iterator[None]:
    """A LabelError within gets the trial that it is about."""
    try:
        yield
    except LabelError as error:
        raise type(error)(
            error.what, where=trial, cause=error.cause, next_step=error.next_step
        ) from None


def doubt(folder: Path) -> LabelError | None:
    """The error in the tags of a folder just watched: sizes, shape, distance, never both seen."""
    try:
        read_motion(folder)
    except LabelError as error:
        return error
    except DataError:
        return None
    return None


def _starts_s(folder: Path, moved: Motion) -> float:
    """Monotonic time of the first tactile sample, s; without samples, of the first frame."""
    try:
        with (folder / TACTILE).open(newline="", encoding="utf-8-sig") as lines:
            # The samples have the time of the same clock in host_ns.
            starts_s = 1e-9 * int(next(csv.DictReader(lines))["host_ns"])
    except FileNotFoundError:
        return float(moved.t_s[0])
    except (StopIteration, KeyError, ValueError, TypeError):
        raise NotANumber(
            "the first row has no host_ns, so its time on the camera's clock is unknown",
            where=folder / TACTILE,
            cause="recorded on another machine, or without host time stamps",
            next_step="record both on one machine",
        ) from None

    if moved.t_s[-1] < starts_s:
        raise TimeError(
            f"the camera's last frame is {starts_s - moved.t_s[-1]:.0f} s before the trial",
            where=folder,
            cause="the video is of another time",
            next_step="film the trial itself",
        )
    return starts_s


def write_label(
    trial: WatchedTrial, action: str | None, gross_mm: float
) -> tuple[str, Json]:
    """Find the slip and write its label beside the trial; returns (a sentence, what was found).

    action: None for the name of the trial's folder. gross_mm: above what the pads give. Raises
    LabelError, UsageError, OutputError.
    """
    from holdfast.drivers.camera.onset import HiddenMotion, find_slip

    moved = trial.moved
    with _placed(trial.path):
        slip = find_slip(moved, gross_mm)
    basis: Json = {"gross_mm": gross_mm, "hidden": None}
    words = f"no onset: the object moved by less than {gross_mm:.2f} mm"
    phases: list[Json] = []
    if isinstance(slip, HiddenMotion):
        # The object moved while a tag was hidden: no time of its start can be given.
        hidden = [round(at_s - trial.starts_s, 6) for at_s in (slip.from_s, slip.to_s)]
        basis["hidden"] = hidden
        span = f"{hidden[0]:.3f} to {hidden[1]:.3f} s"
        words = f"no onset: a tag was hidden from {span} while the object moved"
    elif slip is not None:
        label = _label(action, trial.path)
        phases = [_phase(slip, label, trial.starts_s) | basis]
        words = _sentence(phases[0])

    where = _write_events(trial.path, phases)
    found = {"written": str(where), "phases": phases, **basis}
    frames = {"frames": len(moved.t_s), "frames_seen": moved.seen}
    return f"{words}; {where}", found | frames


def _phase(slip: Slip, label: str, starts_s: float) -> Json:
    """A phase, s from the first sample, to microseconds.

    seen_s: first frame beyond the noise. gross_s: the gross distance. uncertainty_s: of the start.
    """
    times = {
        "t0_s": slip.start_s,
        "t1_s": slip.end_s,
        "onset_s": slip.start_s,
        "seen_s": slip.seen_s,
        "gross_s": slip.gross_s,
    }
    phase: Json = {"label": label, "provenance": PROVENANCE, "by": "holdfast watch"}
    for name, at_s in times.items():
        phase[name] = round(at_s - starts_s, 6)
    return phase | {"uncertainty_s": round(slip.uncertainty_s, 6)}


def _label(action: str | None, path: Path) -> str:
    action = action or path.parent.name
    if action not in ACTIONS:
        raise UsageError(
            f"{path}: {action!r} does not say whether a slip is risky",
            cause="the folder is not named after an action",
            next_step=f"--action {'|'.join(ACTIONS)}",
        )
    return "risky_slip" if action in RISKY else "safe_slip"


def _write_events(folder: Path, phases: list[Json]) -> Path:
    """Write a line for each phase to events.jsonl; earlier lines of a camera are replaced."""
    path = folder / EVENTS
    # Found again, a label replaces the one of an earlier run.
    events = [one for one in read_events(path) if one.get("provenance") != PROVENANCE]
    lines = [f"{json.dumps(event)}\n" for event in (*events, *phases)]
    write_whole(path, "".join(lines))
    # The phases are derived from events.jsonl; now they rest on the camera too.
    if (folder / TRUTH).exists():
        from holdfast.sessions.recorder.labels import relabel

        relabel(folder)
    return path


def _sentence(phase: Json) -> str:
    gross_ms = 1e3 * (phase["gross_s"] - phase["t0_s"])
    sd_ms = 1e3 * phase["uncertainty_s"]
    start = f"{phase['label']} from {phase['t0_s']:.4f} s (sd {sd_ms:.1f} ms)"
    return f"{start}; gross {gross_ms:.0f} ms later"
