"""The folder of a camera recording, and frames on disk: how they are written and read.

    camera.mkv     the frames, lossless (FFV1)
    camera.mcap    the frames' stamps and numbers
    tags.csv       sequence, t_s, tag, x1, y1 .. y4: one line for each tag and frame, or one line
                   without a tag where a frame shows none. t_s is the middle of the exposure
    camera.json    source, fps, exposure, tag, clock, counts, gaps; and why the trial is void, if so

tags.csv is written line by line, so a killed recording keeps its tracks. Only the video needs
depthai; everything else is read with numpy alone.
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, Literal, NamedTuple, TextIO

import msgspec
import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray
from holdfast.core.errors import (
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    OutputError,
    TimeError,
)
from holdfast.core.schema import checked, read
from holdfast.core.writing import write_whole

VIDEO = "camera.mkv"
STAMPS = "camera.mcap"
TAGS = "tags.csv"
ABOUT = "camera.json"
CORNERS = ["x1", "y1", "x2", "y2", "x3", "y3", "x4", "y4"]
COLUMNS = ["sequence", "t_s", "tag", *CORNERS]
Corners = list[float]
Positive = Annotated[float, msgspec.Meta(gt=0.0, le=1000.0)]
LATEST_S = 4e9
"""Of a stamp: 126 years."""
OTHER_UNIT = 10.0
"""Lost frames make steps longer than a period, and ms or us make them much longer."""
LEAST_PX = 24
"""Of a picture's side: the smallest tag that is found, with its margin. A few pixels end the
interpreter in depthai."""


class Lens(msgspec.Struct, frozen=True):
    """What holds for all frames: rate, exposure, printed side of the tags, clock of the stamps.

    clock: "monotonic" (this machine's), or "trial" (from the trial's first sample).
    """

    # depthai takes whole frames a second
    fps: Annotated[float, msgspec.Meta(gt=0.5, le=1000.0)]
    exposure_ms: Positive
    tag_mm: Positive
    clock: Literal["monotonic", "trial"]


class CameraFacts(Lens, frozen=True, kw_only=True):
    """camera.json: the lens, and what became of the frames.

    void: why the trial gets no label, None where nothing went wrong. frames: with tags read.
    lost: numbers that never came.
    """

    source: str = ""
    frames: int = 0
    in_video: int = 0
    lost: int = 0
    void: str | None = None
    family: str = ""
    quad_decimate: int = 0
    depthai: str = ""


def write_about(folder: Path, facts: CameraFacts) -> None:
    """Write camera.json into a folder of images. Raises OutputError."""
    text = msgspec.json.format(msgspec.json.encode(facts), indent=1).decode()
    write_whole(folder / ABOUT, text + "\n")


def read_about(folder: Path) -> CameraFacts:
    """camera.json of a folder. Raises DataNotFound, NotANumber."""
    try:
        return read(folder / ABOUT, CameraFacts, NotANumber)
    except FileNotFoundError:
        raise _not_watched(folder, ABOUT) from None


def _not_watched(folder: Path, name: str) -> DataNotFound:
    return DataNotFound(
        f"no {name}", where=folder, next_step="record with holdfast watch"
    )


# -- tags.csv


@contextmanager
def new_tag_file(folder: Path) -> Iterator[TextIO]:
    """A new tags.csv, line-buffered. Raises OutputError, also where a later line fails."""
    path = folder / TAGS
    try:
        # "x": a recording never overwrites another one
        with path.open("x", encoding="utf-8", buffering=1) as file:
            file.write(",".join(COLUMNS) + "\n")
            yield file
    except OSError as error:
        raise OutputError(
            f"cannot write ({error.strerror})",
            where=path,
            cause="a full disk, no permission, or a file from before",
            next_step="name a new folder on a disk with room",
        ) from None


def write_tags(
    file: TextIO, sequence: int, t_s: float, tags: dict[int, Corners]
) -> None:
    """The tags of one frame; corners [8] as float32, with all digits."""
    head = f"{sequence},{t_s:.6f}"
    if not tags:
        file.write(head + "," * (len(COLUMNS) - 2) + "\n")
    for tag, corners in sorted(tags.items()):
        cells = ",".join(f"{x:.9g}" for x in corners)
        file.write(f"{head},{tag},{cells}\n")


@dataclass(frozen=True)
class Tracks:
    """Tags of a recording: sequence [K], t_s [K] (middle of exposure), corners [K, 4, 2] px by tag.

    Corners are nan where the tag is not seen.
    """

    sequence: npt.NDArray[np.int64]
    t_s: FloatArray
    corners_px: dict[int, FloatArray]

    def of(self, tag: int) -> FloatArray:
        """[K, 4, 2] of a tag; all nan if it was never seen."""
        return self.corners_px.get(tag, np.full((len(self.t_s), 4, 2), np.nan))


def read_tracks(folder: Path) -> Tracks:
    """tags.csv of a folder.

    Raises DataNotFound, ColumnError, NotANumber, EmptyRecording, TimeError.
    """
    path = folder / TAGS
    try:
        head, *lines = path.read_text("utf-8").split("\n")
    except FileNotFoundError:
        raise _not_watched(folder, TAGS) from None
    if head.split(",") != COLUMNS:
        expected = f"expected: {','.join(COLUMNS)}"
        raise ColumnError("unexpected columns", where=path, next_step=expected)
    # nothing stands behind the last line end, or an incomplete line of a killed program
    body = lines[:-1]
    if not body:
        raise EmptyRecording("no frame", where=path, cause="it was stopped at once")
    try:
        table = np.genfromtxt(body, delimiter=",", usecols=range(len(COLUMNS)), ndmin=2)
    except ValueError:
        raise NotANumber(
            "lines differ in their cells", where=path, next_step="record again"
        ) from None
    return _tracks(table, path)


def _tracks(table: FloatArray, path: Path) -> Tracks:
    """The tracks of rows [N, columns]; a frame has a row for each tag, or one without a tag."""
    numbers, tag_of = table[:, 0], table[:, 2]
    sequence, first, frame = np.unique(numbers, return_index=True, return_inverse=True)
    t_s = table[first, 1]
    require_forward(t_s, path)
    corners: dict[int, FloatArray] = {}
    for tag in np.unique(tag_of[np.isfinite(tag_of)]):
        rows = tag_of == tag
        corners[int(tag)] = np.full((len(sequence), 4, 2), np.nan)
        corners[int(tag)][frame[rows]] = table[rows, 3:].reshape(-1, 4, 2)
    return Tracks(sequence.astype(np.int64), t_s, corners)


def require_forward(ends_s: npt.NDArray[np.float64], where: Path) -> None:
    """Raise TimeError where a stamp is not later than the one before, or is no time."""
    # nan fails the comparison
    is_time = np.abs(ends_s) < LATEST_S
    if not is_time.all():
        raise TimeError(
            f"a stamp of {ends_s[~is_time][0]:g} s, which no clock has",
            where=where,
            cause="a camera driver with wrong stamps, or times in another unit than s",
            next_step="record again, or write the times in s",
        )
    if not (np.diff(ends_s) > 0.0).all():
        raise TimeError(
            "a frame is not later than the frame before",
            where=where,
            cause="a camera driver with wrong stamps",
            next_step="record again",
        )


# -- frames on disk


class Frame(NamedTuple):
    """One picture [H, W], its number, and the end of its exposure, s."""

    sequence: int
    end_s: float
    image: npt.NDArray[np.uint8]


def read_frames(path: Path) -> tuple[str, Lens, Iterator[Frame]]:
    """The name, lens and frames of an .npz file.

    The file holds `frames` [K, H, W] uint8, H and W even and from LEAST_PX on, `time_s` [K] ends of
    exposure, fps, exposure_ms and tag_mm. Raises DataNotFound, EmptyRecording, TimeError.
    """
    numbers: dict[str, Any] = {"clock": "trial"}
    try:
        with path.open("rb") as opened, np.load(opened) as file:
            images, ends_s = file["frames"], file["time_s"]
            for name in ("fps", "exposure_ms", "tag_mm"):
                numbers[name] = float(file[name])
    except FileNotFoundError:
        next_step = "check the path; watch takes oak or a .frames.npz"
        raise DataNotFound("no such file", where=path, next_step=next_step) from None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise EmptyRecording(
            f"cannot be read as frames ({error})",
            where=path,
            next_step="docs/camera.md describes the file",
        ) from None

    lens = checked(numbers, Lens, path, EmptyRecording)
    is_grey = images.ndim == 3 and images.dtype == np.uint8 and images.size
    is_odd = any(size % 2 or size < LEAST_PX for size in images.shape[1:3])
    if not is_grey or is_odd or ends_s.shape != images.shape[:1]:
        raise EmptyRecording(
            f"frames are {images.dtype} {images.shape} and stamps {ends_s.shape}",
            where=path,
            cause="the pictures are not grey, too small for a tag, or of an odd size, which no "
            "lossless video has",
            next_step=f"store frames as uint8 [K, H, W], H and W even and from {LEAST_PX} on, and "
            "time_s as [K]",
        )
    require_forward(ends_s, path)
    _require_rate(ends_s, lens.fps, path)
    stamped = zip(range(len(images)), ends_s.tolist(), images, strict=True)
    return path.name, lens, map(Frame._make, stamped)


def _require_rate(ends_s: FloatArray, fps: float, path: Path) -> None:
    """Raise TimeError where stamps are so far from their rate that they have another unit."""
    if len(ends_s) < 2:
        return
    step_s = float(np.median(np.diff(ends_s)))
    if not 1.0 / OTHER_UNIT < step_s * fps < OTHER_UNIT:
        raise TimeError(
            f"frames come every {step_s:g} s, and fps is {fps:g}",
            where=path,
            cause="times in another unit than s, or the fps of another camera",
            next_step="write time_s in s, and the fps that they have",
        )
