"""The folder of a camera recording, and how it is read.

    camera.mkv     the frames, lossless (FFV1)
    camera.mcap    the frames' stamps and numbers
    tags.csv       sequence, t_s, tag, x1, y1 .. y4: one line for each tag and frame, or one line
                   without a tag where a frame shows none. t_s is the middle of the exposure
    camera.json    source, fps, exposure, tag, clock, counts, gaps; and why the trial is void, if so

tags.csv is written line by line, so a killed recording keeps its tracks. Only the video needs
depthai; everything else is read with numpy alone.
"""

from __future__ import annotations

import csv
import json
import math
import time
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path
from queue import Empty, Full, Queue
from threading import Event, get_native_id
from types import TracebackType
from typing import Any, TextIO

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray, Json
from holdfast.core.errors import (
    ColumnError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    OutputError,
)
from holdfast.core.schema import json_of, text_of
from holdfast.core.writing import write_whole
from holdfast.drivers.camera.sources import Frame, Lens, require_forward

VIDEO = "camera.mkv"
STAMPS = "camera.mcap"
TAGS = "tags.csv"
ABOUT = "camera.json"
CORNERS = ["x1", "y1", "x2", "y2", "x3", "y3", "x4", "y4"]
COLUMNS = ["sequence", "t_s", "tag", *CORNERS]
STAMP_S = 2e-6
"""depthai keeps stamps to a microsecond."""
POLL_S = 0.01
AHEAD = 8
NO_IMAGE = np.empty((0, 0), dtype=np.uint8)
Corners = list[float]


class TagFile:
    """A new tags.csv, line-buffered. Raises OutputError."""

    def __init__(self, folder: Path) -> None:
        self.path = folder / TAGS
        try:
            # "x": a recording never overwrites another one
            self._file: TextIO = self.path.open("x", encoding="utf-8", buffering=1)
            self._file.write(",".join(COLUMNS) + "\n")
        except OSError as error:
            raise self._failed(error) from None

    def write(self, sequence: int, t_s: float, tags: dict[int, Corners]) -> None:
        """The tags of one frame; corners [8] as float32, with all digits."""
        head = f"{sequence},{t_s:.6f}"
        lines = [
            ",".join([head, str(tag), *(f"{x:.9g}" for x in at)])
            for tag, at in sorted(tags.items())
        ]
        try:
            self._file.write(
                "".join(
                    f"{line}\n" for line in lines or [head + "," * (len(COLUMNS) - 2)]
                )
            )
        except OSError as error:
            raise self._failed(error) from None

    def _failed(self, error: OSError) -> OutputError:
        return OutputError(
            f"cannot write ({error.strerror})",
            where=self.path,
            cause="a full disk, no permission, or a file from before",
            next_step="name a new folder on a disk with room",
        )

    def __enter__(self) -> TagFile:
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        try:
            self._file.close()
        except OSError as failed:
            if error is None:
                raise self._failed(failed) from None


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
        with path.open(newline="", encoding="utf-8") as lines:
            rows = list(csv.reader(lines))
    except FileNotFoundError:
        raise DataNotFound(
            f"no {TAGS}", where=folder, next_step="record with holdfast watch"
        ) from None
    except (OSError, UnicodeDecodeError, csv.Error) as error:
        raise NotANumber(
            f"cannot be read ({type(error).__name__})",
            where=path,
            next_step="record again",
        ) from None

    if not rows or rows[0] != COLUMNS:
        raise ColumnError(
            "unexpected columns", where=path, next_step=f"expected: {','.join(COLUMNS)}"
        )
    # a killed program leaves an incomplete last line
    body = rows[1:-1] if rows[-1] and len(rows[-1]) < len(COLUMNS) else rows[1:]
    if not body:
        raise EmptyRecording(
            "no frame",
            where=path,
            cause="it was stopped at once",
            next_step="record again",
        )

    try:
        return _tracks(body, path)
    except (ValueError, IndexError):
        raise NotANumber(
            "a line does not hold numbers",
            where=path,
            next_step="read the video again: holdfast watch",
        ) from None


def _tracks(body: list[list[str]], path: Path) -> Tracks:
    stamps = {int(row[0]): float(row[1]) for row in body}
    # a frame has one line for each tag, so its stamp comes several times
    row_of = {sequence: k for k, sequence in enumerate(stamps)}
    t_s = np.array(list(stamps.values()))
    require_forward(t_s, path)
    corners: dict[int, FloatArray] = {}
    for row in body:
        # a frame without a tag has a line of its own
        if not row[2]:
            continue
        tag = int(row[2])
        if tag not in corners:
            corners[tag] = np.full((len(t_s), 4, 2), np.nan)
        places = np.array(row[3:], dtype=np.float64)
        corners[tag][row_of[int(row[0])]] = places.reshape(4, 2)

    return Tracks(np.array(list(stamps), dtype=np.int64), t_s, corners)


def write_about(folder: Path, about: Json) -> None:
    """camera.json. Raises OutputError."""
    write_whole(folder / ABOUT, json.dumps(about, indent=1) + "\n")


def read_about(folder: Path) -> Json:
    """camera.json with the numbers that every reader needs. Raises DataNotFound, NotANumber."""
    path = folder / ABOUT
    try:
        about = json_of(text_of(path))
        Lens.of(about, "")
        return dict(about)
    except FileNotFoundError:
        raise DataNotFound(
            f"no {ABOUT}", where=folder, next_step="record with holdfast watch"
        ) from None
    except (OSError, ValueError, KeyError, TypeError, AttributeError) as error:
        raise NotANumber(
            f"cannot be used ({type(error).__name__})",
            where=path,
            next_step="correct it by hand",
        ) from None


def require_same_stamps(
    frames: list[Frame], tracks: Tracks, lens: Lens, folder: Path
) -> None:
    """Raise ColumnError where the video's numbers and stamps are not those of the tags."""
    middle_s = dict(zip(tracks.sequence.tolist(), tracks.t_s.tolist(), strict=True))
    off = [
        f
        for f in frames
        if abs(middle_s.get(f.sequence, math.inf) + 5e-4 * lens.exposure_ms - f.end_s)
        > STAMP_S
    ]
    # frames after the last tag line have no stamp to compare with
    if len(off) > max(0, len(frames) - len(middle_s)):
        raise ColumnError(
            f"{len(off)} frames of the video have stamps that {TAGS} does not have",
            where=folder,
            cause=f"{STAMPS} is damaged or from another recording",
            next_step="record again",
        )


def require_whole(found: int, expected: object, where: Path) -> None:
    """Raise EmptyRecording where a file has fewer frames than camera.json says."""
    if isinstance(expected, int) and found < expected:
        raise EmptyRecording(
            f"holds {found} of its {expected} frames",
            where=where,
            cause="an interrupted copy, or a broken disk",
            next_step="copy it again from where it was recorded",
        )


def _frame(message: Any, images: bool) -> Frame:
    image = _image(message) if images else NO_IMAGE
    return Frame(
        message.getSequenceNum(), message.getTimestamp().total_seconds(), image
    )


def _image(message: Any) -> npt.NDArray[np.uint8]:
    shape = message.getHeight(), message.getWidth()
    return np.array(message.getData(), dtype=np.uint8)[: shape[0] * shape[1]].reshape(
        shape
    )


def read_video(folder: Path, dai: Any, *, images: bool = True) -> Iterator[Frame]:
    """The frames of a recorded folder, in order, a few in memory at a time.

    The end of the file stops depthai's pipeline at once, and a queue that is pulled would lose the
    last frames. So a callback in depthai's own thread takes them from a queue of one; it waits
    while no frame is taken further. The callback must not raise, and nothing may wait for the
    pipeline: either would end the interpreter. Raises DataNotFound, EmptyRecording.
    """
    pipeline, output = _replayed(folder, dai)
    ahead: Queue[Frame | str] = Queue(AHEAD)
    over = Event()
    threads = set[int]()

    def take(message: Any) -> None:
        threads.add(get_native_id())
        try:
            _hand_on(_frame(message, images), ahead, over)
        except Exception as error:  # an error in a callback would end the interpreter
            _hand_on(f"{type(error).__name__}: {error}", ahead, over)

    output.addCallback(take)
    last: Frame | str | None = None
    try:
        pipeline.start()
        while pipeline.isRunning() or not ahead.empty():
            with suppress(Empty):
                last = ahead.get(timeout=POLL_S)
                if isinstance(last, str):
                    break
                yield last
    finally:
        over.set()
        pipeline.stop()
        _wait_for_end(threads)

    if not isinstance(last, Frame):
        raise EmptyRecording(
            f"the video cannot be read ({last or 'no frame'})",
            where=folder / VIDEO,
            cause="it was cut off, or another program wrote it",
            next_step=f"{TAGS} may still hold the tracks: holdfast watch --onset",
        )


def _replayed(folder: Path, dai: Any) -> tuple[Any, Any]:
    """A pipeline that plays a folder's video as fast as it is read, and its output queue."""
    # a clear error here, before depthai meets a missing file
    for name in (VIDEO, STAMPS):
        if not (folder / name).is_file():
            raise DataNotFound(
                f"no {name}",
                where=folder,
                next_step="give a folder that holdfast watch made",
            )

    pipeline = dai.Pipeline(createImplicitDevice=False)
    replay = pipeline.create(dai.node.ReplayVideo)
    replay.setReplayVideoFile(folder / VIDEO)
    replay.setReplayMetadataFile(folder / STAMPS)
    replay.setOutFrameType(dai.ImgFrame.Type.GRAY8)
    replay.setLoop(False)
    # as fast as the reader takes them
    replay.setFps(1000)
    return pipeline, replay.out.createOutputQueue(maxSize=1, blocking=False)


def _wait_for_end(threads: set[int]) -> None:
    """Wait until depthai's threads have ended.

    Releasing the pipeline earlier waits for these threads with the interpreter lock held, and they
    wait for that lock.
    """
    while any(Path(f"/proc/self/task/{thread}").exists() for thread in threads):
        time.sleep(POLL_S)


def _hand_on(found: Frame | str, ahead: Queue[Frame | str], over: Event) -> None:
    """Wait for room in the queue, until the reader has stopped."""
    while not over.is_set():
        with suppress(Full):
            ahead.put(found, timeout=POLL_S)
            return
