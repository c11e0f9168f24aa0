"""The label of a slip that a camera saw: found in the motion, written beside the trial.

The object's motion in the hand as a camera saw it, from a watched folder or stored frames.
"""

from __future__ import annotations

import csv
import json
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.core.errors import (
    DataError,
    DataNotFound,
    LabelError,
    NotANumber,
    TimeError,
    UsageError,
)
from holdfast.core.reading import Json, require_lines
from holdfast.core.trial_layout import (
    EVENTS,
    FRAMES_SUFFIX,
    ONSET_SUFFIX,
    RISKY_ACTIONS,
    TACTILE,
    TRUTH,
    VOLUNTARY_ACTIONS,
    read_events,
)
from holdfast.core.writing import write_whole

if TYPE_CHECKING:
    from holdfast.drivers.camera.motion import Motion
    from holdfast.drivers.camera.onset import Slip


OBJECT_TAG, HAND_TAG = 0, 1


@dataclass(frozen=True)
class WatchedTrial:
    """A trial's path, the motion that the camera saw, start of its clock in the frames', s."""

    path: Path
    moved: Motion
    starts_s: float


def read(
    path: Path, tag_mm: float | None = None, apart_mm: float | None = None
) -> WatchedTrial:
    """The object's motion in the hand, from a watched folder or frames beside a trial.

    Raises a DataError.
    """
    if path.is_dir():
        return watched(path, path, tag_mm, apart_mm)
    from holdfast.drivers.camera.graph import watch
    from holdfast.drivers.camera.sources import read_frames
    from holdfast.live.running import say

    frames = (
        path if path.name.endswith(FRAMES_SUFFIX) else path.with_suffix(FRAMES_SUFFIX)
    )
    if not frames.exists():
        raise _no_frames(path, frames)
    with tempfile.TemporaryDirectory() as folder:
        watch(read_frames(frames), Path(folder), say=say)
        trial = frames.with_name(frames.name.removesuffix(FRAMES_SUFFIX) + ".csv")
        return watched(Path(folder), trial, tag_mm, apart_mm)


def _no_frames(path: Path, frames: Path) -> DataNotFound:
    """The error for a trial without frames; it names the path that was given."""
    there = path.exists() and path != frames
    return DataNotFound(
        f"no frames beside this trial, {frames.name} is missing"
        if there
        else "no such trial",
        where=path,
        next_step="film a trial with holdfast watch or holdfast record --camera"
        if there
        else "give a folder of holdfast watch or record, or trial_n.csv with trial_n.frames.npz",
    )


def watched(
    folder: Path, trial: Path, tag_mm: float | None, apart_mm: float | None
) -> WatchedTrial:
    """Read a watched folder; trial: what its label belongs to. Raises LabelError if it is void."""
    from holdfast.drivers.camera.motion import motion
    from holdfast.drivers.camera.recording import (
        TAGS,
        read_about,
        read_tracks,
        require_whole,
    )

    about = read_about(folder)
    if about.get("void"):
        raise LabelError(
            "the trial is void and gets no label",
            where=folder,
            cause=str(about["void"]),
            next_step="record it again",
        )
    tracks = read_tracks(folder)
    require_whole(len(tracks.t_s), about.get("frames"), folder / TAGS)
    try:
        moved = motion(
            tracks.t_s,
            tracks.of(OBJECT_TAG),
            tracks.of(HAND_TAG),
            tag_mm or float(about["tag_mm"]),
            apart_mm or about.get("apart_mm"),
        )
    except LabelError as error:
        raise type(error)(
            error.what, where=trial, cause=error.cause, next_step=error.next_step
        ) from None
    return WatchedTrial(
        trial, moved, 0.0 if about.get("clock") == "trial" else _starts_s(trial, moved)
    )


def doubt(folder: Path) -> LabelError | None:
    """The error in the tags of a folder just watched: sizes, shape, distance, never both seen."""
    try:
        watched(folder, folder, None, None)
    except LabelError as error:
        return error
    except DataError:
        return None
    return None


def _starts_s(folder: Path, moved: Motion) -> float:
    """Monotonic time of the first tactile sample, s; without samples, of the first frame."""
    try:
        require_lines(folder / TACTILE)
        with (folder / TACTILE).open(newline="", encoding="utf-8-sig") as lines:
            starts_s = 1e-9 * int(next(csv.DictReader(lines))["host_ns"])
    except FileNotFoundError:
        return float(moved.t_s[0])
    except (OSError, StopIteration, KeyError, ValueError, TypeError, csv.Error):
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


RISKY = (*RISKY_ACTIONS, "hold")
ACTIONS = (*RISKY, *VOLUNTARY_ACTIONS)
PROVENANCE, BY = "camera", "holdfast onset"


@dataclass(frozen=True)
class CameraInterval:
    """A phase as in trial_<n>.truth.json with more of the camera's times, s from the first sample.

    seen_s: first frame beyond the noise. gross_s: the gross distance. start_sd_s, uncertainty_s:
    of the start. frame_s: time between two frames.
    """

    t0_s: float
    t1_s: float
    onset_s: float
    duration_s: float
    label: str
    provenance: str
    by: str
    seen_s: float
    gross_s: float
    start_sd_s: float
    frame_s: float
    uncertainty_s: float

    @staticmethod
    def of(slip: Slip, label: str, starts_s: float) -> CameraInterval:
        """From a slip whose times count from another start, to microseconds."""
        start_s = round(slip.start_s - starts_s, 6)
        return CameraInterval(
            t0_s=start_s,
            t1_s=round(slip.end_s - starts_s, 6),
            onset_s=start_s,
            duration_s=round(slip.end_s - slip.start_s, 6),
            label=label,
            provenance=PROVENANCE,
            by=BY,
            seen_s=round(slip.seen_s - starts_s, 6),
            gross_s=round(slip.gross_s - starts_s, 6),
            start_sd_s=round(slip.start_sd_s, 6),
            frame_s=round(slip.frame_s, 6),
            uncertainty_s=round(slip.uncertainty_s, 6),
        )


@dataclass(frozen=True)
class LabelBasis:
    """What a label rests on. pad_shear: measured or not. hidden: span of a hidden tag, s, or None.

    threshold_mm, sigma_mm: of the motion, beyond which it is no noise. frames_seen: with all tags.
    """

    gross_mm: float
    pad_shear: str
    hidden: dict[str, float] | None
    threshold_mm: float
    sigma_mm: float
    mm_per_px: float
    frames: int
    frames_seen: int


@dataclass(frozen=True)
class WrittenLabel:
    """A label in its file, and a sentence about it."""

    words: str
    where: Path
    intervals: list[CameraInterval]
    basis: LabelBasis

    def to_json(self) -> Json:
        """With the intervals as phases."""
        phases = [asdict(one) for one in self.intervals]
        return {"written": str(self.where), "phases": phases, **asdict(self.basis)}


def write(
    trial: WatchedTrial, action: str | None, gross_mm: float, *, shear_known: bool
) -> WrittenLabel:
    """Find the slip and write its label beside the trial."""
    from holdfast.drivers.camera.onset import Slip, find_slip

    try:
        found = find_slip(trial.moved, gross_mm)
    except LabelError as error:
        raise LabelError(
            error.what, where=trial.path, cause=error.cause, next_step=error.next_step
        ) from None
    slip = found if isinstance(found, Slip) else None
    label = _label(action, trial.path) if slip else ""
    intervals = [CameraInterval.of(slip, label, trial.starts_s)] if slip else []
    gap = None if found is None or slip else _shifted(asdict(found), trial.starts_s)
    write_labels = _write_events if trial.path.is_dir() else _write_beside
    how = _how(trial, gross_mm, gap, shear_known=shear_known)
    where = write_labels(trial.path, intervals, how)
    if intervals:
        words = _sentence(intervals[0], where)
    elif gap:
        span = f"{gap['from_s']:.3f} to {gap['to_s']:.3f} s"
        words = (
            f"no onset: a tag was hidden from {span} while the object moved; {where}"
        )
    else:
        words = f"no onset: the object moved by less than {gross_mm:.2f} mm; {where}"
    return WrittenLabel(words, where, intervals, how)


def _how(
    trial: WatchedTrial,
    gross_mm: float,
    gap: dict[str, float] | None,
    *,
    shear_known: bool,
) -> LabelBasis:
    return LabelBasis(
        gross_mm=gross_mm,
        pad_shear="measured" if shear_known else "not measured",
        hidden=gap,
        threshold_mm=round(trial.moved.threshold_mm, 4),
        sigma_mm=round(trial.moved.sigma_mm, 5),
        mm_per_px=round(trial.moved.mm_per_px, 5),
        frames=len(trial.moved.t_s),
        frames_seen=trial.moved.seen,
    )


def _label(action: str | None, path: Path) -> str:
    action = action or path.parent.name
    if action not in ACTIONS:
        raise UsageError(
            f"{path}: {action!r} does not say whether a slip is risky",
            cause="the folder is not named after an action",
            next_step=f"--action {'|'.join(ACTIONS)}",
        )
    return "risky_slip" if action in RISKY else "safe_slip"


def _shifted(times: dict[str, float], starts_s: float) -> dict[str, float]:
    return {name: round(value - starts_s, 6) for name, value in times.items()}


def _write_beside(
    trial: Path, intervals: list[CameraInterval], how: LabelBasis
) -> Path:
    """Write trial_n.onset.json with phases as in trial_n.truth.json, which does not change."""
    content = {"phases": [asdict(one) for one in intervals], **asdict(how)}
    return write_whole(
        trial.with_suffix(ONSET_SUFFIX), json.dumps(content, indent=1) + "\n"
    )


def _write_events(
    folder: Path, intervals: list[CameraInterval], how: LabelBasis
) -> Path:
    """Write a line for each interval to events.jsonl; earlier lines of a camera are replaced."""
    path = folder / EVENTS
    kept = [
        json.dumps(event)
        for event in read_events(path)
        if event.get("provenance") != PROVENANCE
    ]
    lines = [*kept, *(json.dumps(asdict(one) | asdict(how)) for one in intervals)]
    written = write_whole(path, "".join(f"{line}\n" for line in lines))
    if (folder / TRUTH).exists():
        from holdfast.sessions.recorder.labels import relabel

        relabel(folder)
    return written


def _sentence(of: CameraInterval, where: Path) -> str:
    seen_ms, gross_ms = 1e3 * (of.seen_s - of.t0_s), 1e3 * (of.gross_s - of.t0_s)
    return (
        f"{of.label} from {of.t0_s:.4f} s (sd {1e3 * of.uncertainty_s:.1f} ms); "
        f"beyond noise {seen_ms:.0f} ms later, gross {gross_ms:.0f} ms later; {where}"
    )
