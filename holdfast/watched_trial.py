"""The object's motion in the hand as a camera saw it, from a watched folder or stored frames."""

from __future__ import annotations

import csv
import tempfile
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.edge_runtime.errors import DataError, DataNotFound, LabelError, NotANumber, TimeError
from holdfast.edge_runtime.reading import require_lines
from holdfast.edge_runtime.trial_layout import FRAMES_SUFFIX, TACTILE

if TYPE_CHECKING:
    from holdfast.drivers.camera.motion import Motion

OBJECT_TAG, HAND_TAG = 0, 1


@dataclass(frozen=True)
class WatchedTrial:
    """A trial's path, the motion that the camera saw, start of its clock in the frames', s."""

    path: Path
    moved: Motion
    starts_s: float


def read(path: Path, tag_mm: float | None = None, apart_mm: float | None = None) -> WatchedTrial:
    """The object's motion in the hand, from a watched folder or frames beside a trial.

    Raises a DataError.
    """
    if path.is_dir():
        return watched(path, path, tag_mm, apart_mm)
    from holdfast.drivers.camera.graph import watch
    from holdfast.drivers.camera.sources import read_frames
    from holdfast.messages import say

    frames = path if path.name.endswith(FRAMES_SUFFIX) else path.with_suffix(FRAMES_SUFFIX)
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
        f"no frames beside this trial, {frames.name} is missing" if there else "no such trial",
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
    from holdfast.drivers.camera.recording import TAGS, read_about, read_tracks, require_whole

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
