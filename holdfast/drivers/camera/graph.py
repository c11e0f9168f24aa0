"""The graph: frames -> lossless video, and -> tags -> tags.csv. Only the source differs.

Four properties of depthai shape this code. An error in a callback ends the interpreter, so no
Python runs in depthai's threads and answers are pulled. By default inputs drop frames, so they
block here. What is queued when a pipeline stops is lost, so the queues are emptied first. A video
that could not be written raises no error, so it is read again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import timedelta
from importlib.metadata import version
from pathlib import Path
from typing import Any

from holdfast.core.errors import (
    DeviceLost,
    EmptyRecording,
    HoldfastError,
    OutputError,
    TimeError,
)
from holdfast.drivers.camera.recording import (
    ABOUT,
    STAMPS,
    TAGS,
    VIDEO,
    Corners,
    TagFile,
    read_tracks,
    read_video,
    require_same_stamps,
    write_about,
)
from holdfast.drivers.camera.sources import LONGEST_WAIT_S, FrameSource, load_depthai

FAMILY = "36h11"
QUAD_DECIMATE = 2
THREADS = 1
"""Decimation 4, the default, loses tags of 30 px.

On a busy machine two threads take 10 times as long.
"""
ANSWERS = 30
LIVE_WAIT_S = 0.1
MOST_QUIET = round(LONGEST_WAIT_S / LIVE_WAIT_S)
"""Waits without an answer after which none is expected any more."""
EMPTY_POLLS = 6
POLL_S = 0.01


@dataclass(frozen=True)
class CameraResult:
    """The result of a run.

    Frames with tags read, lost frames, stamps that went back, frames in the video.
    """

    frames: int
    lost: int
    backwards: int
    in_video: int


def watch(
    source: FrameSource,
    out: Path,
    *,
    say: Callable[[str], None],
    stopped: Callable[[], bool] = lambda: False,
) -> CameraResult:
    """Run the graph on a source until it ends or is stopped, and leave a recording in `out`.

    Whatever goes wrong, the recording so far is kept, camera.json says why the trial is void, and
    the error is raised: CameraUnavailable, DeviceLost, TransferFailed, OutputError, or what the
    source raises.
    """
    dai = load_depthai(say)
    try:
        pipeline = source.open(dai)
        return _Watch(dai, pipeline, source, out).run(stopped)
    finally:
        source.close()


class _Watch:
    """One run of the graph."""

    def __init__(self, dai: Any, pipeline: Any, source: FrameSource, out: Path) -> None:
        self.dai = dai
        self.pipeline = pipeline
        self.source = source
        self.out = out
        self.last = -1
        self.last_s = -math.inf
        self.frames = self.lost = self.backwards = 0
        _require_empty(out)

    def run(self, stopped: Callable[[], bool]) -> CameraResult:
        """Record, then check the video, then write the result to camera.json."""
        # written first, so that a killed recording says so
        self._about("interrupted")
        failed: HoldfastError | None = None
        try:
            self._film(stopped)
        except HoldfastError as error:
            failed = error

        # read even after a failure: the frames so far are worth keeping
        in_video, unread = self._in_video()
        failed = failed or unread
        self._about(str(failed) if failed else None, in_video)
        if failed is not None:
            raise failed
        return CameraResult(self.frames, self.lost, self.backwards, in_video)

    def _film(self, stopped: Callable[[], bool]) -> None:
        record = self._record()
        tagger = self._tagger()
        answers = tagger.out.createOutputQueue(maxSize=ANSWERS, blocking=True)
        step = self.source.connect(
            self.dai, self.pipeline, [record.input, tagger.inputImage]
        )
        with TagFile(self.out) as tags:
            try:
                self.pipeline.start()
                self._pull(step, stopped, answers, tags)
            finally:
                _drain(record)
                self.pipeline.stop()
                self.pipeline.wait()  # safe to wait for: no callback runs in its threads

    def _record(self) -> Any:
        record = self.pipeline.create(self.dai.node.RecordVideo)
        record.setRecordVideoFile(self.out / VIDEO)
        record.setRecordMetadataFile(self.out / STAMPS)
        record.setFps(
            round(self.source.lens.fps)
        )  # without it the first nine frames are lost
        return record

    def _tagger(self) -> Any:
        tagger = self.pipeline.create(self.dai.node.AprilTag)
        tagger.setRunOnHost(True)
        tagger.setNumThreads(THREADS)
        tagger.initialConfig.setFamily(self.dai.AprilTagConfig.Family.TAG_36H11)
        tagger.initialConfig.quadDecimate = QUAD_DECIMATE
        tagger.inputImage.setBlocking(True)
        return tagger

    def _pull(
        self,
        step: Callable[[], bool],
        stopped: Callable[[], bool],
        answers: Any,
        tags: TagFile,
    ) -> None:
        """Pass frames on and take answers.

        The source's error is raised once its frames are answered.
        """
        sent = 0
        failed = None
        # a camera goes on by itself; frames from disk wait for their answers
        live = bool(self.source.last_lost)
        try:
            while not stopped() and step():
                sent += 1
                self._take(answers, tags, LIVE_WAIT_S if live else 0.0)
                if not self.pipeline.isRunning():
                    raise _lost(self.source.name)
        except HoldfastError as error:
            failed = error

        quiet = 0
        wanted = 0 if live else sent
        while self.frames < wanted and quiet < MOST_QUIET and self.pipeline.isRunning():
            quiet = 0 if self._take(answers, tags, LIVE_WAIT_S) else quiet + 1

        if failed is None and self.frames < wanted:
            failed = _lost("depthai")
        if failed is not None:
            raise failed

    def _take(self, answers: Any, tags: TagFile, wait_s: float) -> bool:
        """Write down the answers so far, waiting a little for the first; whether there were any."""
        try:
            message = (
                answers.get(timedelta(seconds=wait_s)) if wait_s else answers.tryGet()
            )
            any_yet = message is not None
            while message is not None:
                self._note(message, tags)
                message = answers.tryGet()
            return any_yet
        except self.dai.MessageQueue.QueueException:
            raise _lost(self.source.name) from None

    def _note(self, message: Any, tags: TagFile) -> None:
        sequence = int(message.getSequenceNum())
        end_s = message.getTimestamp().total_seconds()
        self.lost += max(0, sequence - self.last - 1) if self.frames else 0
        # counted here and judged at the end, when the whole recording is known
        self.backwards += end_s <= self.last_s
        self.last = sequence
        self.last_s = end_s
        self.frames += 1
        tags.write(
            sequence,
            end_s - 5e-4 * self.source.lens.exposure_ms,
            _corners(message.aprilTags),
        )

    def _in_video(self) -> tuple[int, HoldfastError | None]:
        """Frames that the video really holds, and what is wrong with it.

        Depthai reports no write errors.
        """
        if not self.frames:
            return 0, EmptyRecording(
                "no frame was recorded",
                where=self.source.name,
                cause="it was stopped at once",
            )
        if self.backwards:
            return 0, TimeError(
                f"{self.backwards} frames are not later than the frame before",
                where=self.out / TAGS,
                cause="the camera's clock was being aligned with this machine's",
                next_step="record again",
            )

        try:
            video = list(read_video(self.out, self.dai, images=False))
            tracks = read_tracks(self.out)
            require_same_stamps(video, tracks, self.source.lens, self.out)
        except HoldfastError as error:
            return 0, OutputError(
                f"the video was not written ({error.what})",
                where=self.out / VIDEO,
                cause="a full disk",
                next_step=f"make room and record again; {TAGS} holds the tracks",
            )

        wanted = tracks.sequence.tolist()[
            : len(tracks.sequence) - self.source.last_lost
        ]
        missing = set(wanted) - {frame.sequence for frame in video}
        if not missing:
            return len(video), None
        return len(video), OutputError(
            f"{len(missing)} of {self.frames} frames are not in the video",
            where=self.out / VIDEO,
            cause="a full disk, or a machine too slow for lossless video",
            next_step="make room, or record fewer frames a second",
        )

    def _about(self, void: str | None, in_video: int = 0) -> None:
        lens = self.source.lens
        write_about(
            self.out,
            {
                "source": self.source.name,
                "fps": lens.fps,
                "exposure_ms": lens.exposure_ms,
                "tag_mm": lens.tag_mm,
                "apart_mm": lens.apart_mm,
                "clock": lens.clock,
                "family": FAMILY,
                "quad_decimate": QUAD_DECIMATE,
                "frames": self.frames,
                "in_video": in_video,
                "lost": self.lost,
                "backwards": self.backwards,
                "void": void,
                "depthai": version("depthai"),
            },
        )


def _corners(found: Any) -> dict[int, Corners]:
    """Corners [8] by tag, top left first, clockwise; a tag seen twice in one frame is left out."""
    # two tags of one number: nothing tells which is the printed one
    ids = [one.id for one in found]
    corners: dict[int, Corners] = {}
    for one in found:
        if ids.count(one.id) > 1:
            continue
        square = (one.topLeft, one.topRight, one.bottomRight, one.bottomLeft)
        corners[one.id] = []
        for corner in square:
            corners[one.id] += [corner.x, corner.y]

    return corners


def _drain(record: Any) -> None:
    """Wait until the video's queue has been empty for a while.

    Stopping would discard what is in it.
    """
    empty = 0
    for _ in range(round(LONGEST_WAIT_S / POLL_S)):
        empty = 0 if record.input.getSize() else empty + 1
        if empty == EMPTY_POLLS:
            break
        time.sleep(POLL_S)


def _lost(name: str) -> DeviceLost:
    return DeviceLost(
        "frames stopped coming",
        where=name,
        cause="it was unplugged, its power dipped, or a node of the graph stopped",
        next_step="record again, with a short cable and its own power; the frames so far are kept",
    )


def _require_empty(out: Path) -> None:
    there = [name for name in (VIDEO, STAMPS, TAGS, ABOUT) if (out / name).exists()]
    if there:
        raise OutputError(
            f"holds {there[0]} already",
            where=out,
            next_step="name a new folder, or remove this one",
        )
