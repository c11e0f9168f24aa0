"""The graph: frames -> lossless video, and -> tags -> tags.csv. Only the source differs: an OAK
camera, or frames on disk (recording.py).

The only import of depthai is here: late, and with its telemetry switched off first. Four properties
of depthai shape this code. An error in a callback ends the interpreter, so no Python that may raise
runs in depthai's threads, and answers are pulled. By default inputs drop frames, so they block
here. What is queued when a pipeline stops is lost, so the queues are emptied first. A video that
could not be written raises no error, so it is read again.
"""

from __future__ import annotations

import math
import os
import time
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from importlib import import_module
from importlib.metadata import version
from pathlib import Path
from threading import get_native_id
from typing import Any, TextIO

import msgspec
import numpy as np

from holdfast.core.errors import (
    CameraUnavailable,
    DeviceLost,
    HoldfastError,
    OutputError,
    TransferFailed,
    needs_extra,
)
from holdfast.drivers.camera.recording import (
    ABOUT,
    STAMPS,
    TAGS,
    VIDEO,
    CameraFacts,
    Corners,
    Frame,
    Lens,
    new_tag_file,
    read_tracks,
    write_about,
    write_tags,
)

OAK = "oak"
OAK_SIZE = (640, 400)
"""One core cannot write lossless video of more pixels at 60 frames a second."""
OAK_ISO = 800
QUEUE, ANSWERS = 4, 30
PUT_POLL_S = 0.001
LONGEST_WAIT_S = 10.0
LOSSLESS_LAST = 20
"""A camera films on while it is stopped: this many last frames may have tags and no picture."""
QUIET = {
    "DEPTHAI_TELEMETRY": "0",
    "DEPTHAI_CRASHDUMP": "0",
    "DEPTHAI_DISABLE_CRASHDUMP_COLLECTION": "1",
    "DEPTHAI_ZOO_INTERNET_CHECK": "0",
    "DEPTHAI_PROTOCOL": "usb",
    "DEPTHAI_SEARCH_TIMEOUT": "1500",
    "DEPTHAI_LEVEL": "error",
    "DEPTHAI_INSTALL_SIGNAL_HANDLER": "0",
    "OPENCV_FOR_THREADS_NUM": "1",
}
"""Environment of depthai unless the user has set it: no telemetry, no dumps, no network.

It also searches 1.5 s instead of ten, logs errors only, and installs no signal handler (with it, a
file-size limit kills the process). Video is written by one thread, because further threads wait for
each frame busily, with thousands of wake-ups a second and a sixth of a core.
"""
FAMILY = "36h11"
QUAD_DECIMATE = 2
THREADS = 1
"""Decimation 4, the default, loses tags of 30 px.

On a busy machine two threads take 10 times as long.
"""
LIVE_WAIT_S = 0.1
EMPTY_POLLS, POLL_S = 6, 0.01


def load_depthai() -> Any:
    """Import depthai after putting QUIET into the environment. Raises LibraryMissing.

    depthai reads its environment once, when it is imported; a later change has no effect.
    """
    for name, value in QUIET.items():
        # what the user has set stays
        os.environ.setdefault(name, value)
    with needs_extra("camera"):
        return import_module("depthai")


# -- where frames come from


@dataclass
class StoredFrames:
    """Frames from disk (read_frames) or from an iterable, through a pipeline without a device.

    last_lost: frames at the end that a stop may cost the video.
    """

    last_lost = 0
    name: str
    lens: Lens
    frames: Iterable[Frame]

    def open(self, dai: Any) -> Any:
        """A pipeline that has no device and looks for none."""
        return dai.Pipeline(createImplicitDevice=False)

    def connect(
        self, dai: Any, pipeline: Any, inputs: Sequence[Any]
    ) -> Callable[[], bool]:
        """One queue for each input; each step puts one frame into all of them, from our thread."""
        # blocking: a dropped frame would be a gap in the track
        queues = [one.createInputQueue(maxSize=QUEUE, blocking=True) for one in inputs]
        frames = iter(self.frames)

        def step() -> bool:
            frame = next(frames, None)
            if frame is None:
                return False
            message = _message(dai, frame)
            for queue in queues:
                _put(dai, queue, message, pipeline)
            return True

        return step

    def close(self) -> None:
        """Nothing is open."""


@dataclass
class Oak:
    """An OAK camera on USB, global shutter, fixed exposure, stamps on this machine's clock.

    A camera that falls off the bus does not come back within a trial: the trial is void.
    """

    name = OAK
    last_lost = LOSSLESS_LAST

    lens: Lens
    seconds: float | None = None
    """After them it ends, None: when it is stopped."""
    device: Any = None

    def open(self, dai: Any) -> Any:
        """Open the first camera found. Raises CameraUnavailable."""
        try:
            self.device = dai.Device()
        except RuntimeError as error:
            raise CameraUnavailable(
                f"no camera ({error})",
                where=OAK,
                cause="not plugged in, a cable for power only, or no udev rule for 03e7",
                next_step="lsusb -d 03e7: lists it if it is there; docs/camera.md has the rule",
            ) from None
        self.device.setMaxReconnectionAttempts(0)
        pipeline = dai.Pipeline(self.device)
        pipeline.setStopOnDeviceLoss(True)
        return pipeline

    def connect(
        self, dai: Any, pipeline: Any, inputs: Sequence[Any]
    ) -> Callable[[], bool]:
        """The camera sends frames to the inputs by itself.

        A step only checks whether the time is up.
        """
        camera = pipeline.create(dai.node.Camera).build(sensorFps=self.lens.fps)
        exposure_us = round(1e3 * self.lens.exposure_ms)
        camera.initialControl.setManualExposure(exposure_us, OAK_ISO)
        output = camera.requestOutput(
            OAK_SIZE, type=dai.ImgFrame.Type.GRAY8, fps=self.lens.fps
        )
        for one in inputs:
            output.link(one)
        until_s = time.monotonic() + (self.seconds or math.inf)
        return lambda: time.monotonic() < until_s

    def close(self) -> None:
        if self.device is not None:
            self.device.close()


FrameSource = StoredFrames | Oak


def _message(dai: Any, frame: Frame) -> Any:
    message = dai.ImgFrame()
    message.setType(dai.ImgFrame.Type.GRAY8)
    message.setSize(frame.image.shape[1], frame.image.shape[0])
    message.setData(np.ascontiguousarray(frame.image).ravel())
    message.setSequenceNum(frame.sequence)
    # video and tags must carry the same stamp
    for stamp in (message.setTimestamp, message.setTimestampDevice):
        stamp(timedelta(seconds=frame.end_s))

    return message


def _put(dai: Any, queue: Any, message: Any, pipeline: Any) -> None:
    """Wait for room.

    Raises TransferFailed where the graph stopped or takes nothing for ten seconds.
    """
    until_s = time.monotonic() + LONGEST_WAIT_S
    while pipeline.isRunning() and time.monotonic() < until_s:
        # a stopping graph has closed the queue
        with suppress(dai.MessageQueue.QueueException):
            if queue.trySend(message):
                return
        time.sleep(PUT_POLL_S)
    raise TransferFailed(
        "the graph takes no more frames",
        where="depthai",
        cause="a node of the graph stopped",
        next_step="run again with DEPTHAI_LEVEL=info, which logs the reason",
    )


# -- the graph


def watch(
    source: FrameSource, out: Path, *, stopped: Callable[[], bool] = lambda: False
) -> CameraFacts:
    """Run the graph on a source until it ends or is stopped, and leave a recording in `out`.

    Whatever goes wrong, the recording so far is kept, camera.json says why the trial is void, and
    the error is raised: CameraUnavailable, DeviceLost, TransferFailed, OutputError, or what the
    source raises.
    """
    dai = load_depthai()
    # of the files of a recording it is the first that is written
    if (out / ABOUT).exists():
        raise OutputError(
            f"holds {ABOUT} already",
            where=out,
            next_step="name a new folder, or remove this one",
        )
    facts = CameraFacts(
        **msgspec.structs.asdict(source.lens),
        source=source.name,
        family=FAMILY,
        quad_decimate=QUAD_DECIMATE,
        void="interrupted",
        depthai=version("depthai"),
    )
    pipeline = source.open(dai)
    failed: HoldfastError | None = None
    try:
        # written first, so that a killed recording says so
        write_about(out, facts)
        _film(dai, pipeline, source, out, stopped)
    except HoldfastError as error:
        failed = error
    finally:
        source.close()

    # counted even after a failure: the frames so far are worth keeping
    facts, unread = _counted(facts, dai, source, out)
    failed = failed or unread
    facts = msgspec.structs.replace(facts, void=str(failed) if failed else None)
    write_about(out, facts)
    if failed is not None:
        raise failed
    return facts


# -- filming


def _film(
    dai: Any,
    pipeline: Any,
    source: FrameSource,
    out: Path,
    stopped: Callable[[], bool],
) -> None:
    record = pipeline.create(dai.node.RecordVideo)
    record.setRecordVideoFile(out / VIDEO)
    record.setRecordMetadataFile(out / STAMPS)
    # without it the first nine frames are lost
    record.setFps(round(source.lens.fps))
    tagger = _tagger(dai, pipeline)
    answers = tagger.out.createOutputQueue(maxSize=ANSWERS, blocking=True)
    step = source.connect(dai, pipeline, [record.input, tagger.inputImage])
    with new_tag_file(out) as tags:
        try:
            pipeline.start()
            while not stopped() and step():
                _take(dai, source, answers, tags)
                if not pipeline.isRunning():
                    raise _lost(source.name)
        finally:
            _drain(record)
            pipeline.stop()
            pipeline.wait()  # safe to wait for: no callback runs in its threads


def _tagger(dai: Any, pipeline: Any) -> Any:
    tagger = pipeline.create(dai.node.AprilTag)
    tagger.setRunOnHost(True)
    tagger.setNumThreads(THREADS)
    tagger.initialConfig.setFamily(dai.AprilTagConfig.Family.TAG_36H11)
    tagger.initialConfig.quadDecimate = QUAD_DECIMATE
    tagger.inputImage.setBlocking(True)
    return tagger


def _take(dai: Any, source: FrameSource, answers: Any, tags: TextIO) -> None:
    """Write down the answers that have come. Raises DeviceLost.

    Each frame from disk is answered before the next is sent; a camera goes on by itself.
    """
    is_live = source.last_lost > 0
    wait_s = LIVE_WAIT_S if is_live else LONGEST_WAIT_S
    try:
        message = answers.get(timedelta(seconds=wait_s))
        if message is None and not is_live:
            raise _lost("depthai")
        while message is not None:
            end_s = message.getTimestamp().total_seconds()
            middle_s = end_s - 5e-4 * source.lens.exposure_ms
            corners = _corners(message.aprilTags)
            write_tags(tags, int(message.getSequenceNum()), middle_s, corners)
            message = answers.tryGet()
    except dai.MessageQueue.QueueException:
        raise _lost(source.name) from None


# -- what was filmed


def _counted(
    facts: CameraFacts, dai: Any, source: FrameSource, out: Path
) -> tuple[CameraFacts, HoldfastError | None]:
    """The facts with counts of tags and frames, and what is wrong with them.

    depthai reports no error of a video that it cannot write.
    """
    try:
        tracks = read_tracks(out)
    except HoldfastError as error:
        return facts, error
    numbers = tracks.sequence.tolist()
    in_video = frames_of_video(out, dai)
    facts = msgspec.structs.replace(
        facts,
        frames=len(numbers),
        lost=numbers[-1] - numbers[0] + 1 - len(numbers),
        in_video=len(in_video),
    )
    required = max(1, len(numbers) - source.last_lost)
    missing = set(numbers[:required]) - in_video
    if not missing:
        return facts, None
    return facts, OutputError(
        f"{len(missing)} of {len(numbers)} frames are not in the video",
        where=out / VIDEO,
        cause="a full disk, or a machine too slow for lossless video",
        next_step=f"make room and record again; {TAGS} holds the tracks",
    )


def frames_of_video(folder: Path, dai: Any) -> set[int]:
    """The numbers of the frames of a recorded video.

    The end of the file stops depthai's pipeline at once, and a queue that is pulled would lose the
    last frames. So a callback in depthai's own thread takes them.
    """
    if not (folder / VIDEO).is_file():
        return set()
    pipeline = dai.Pipeline(createImplicitDevice=False)
    replay = pipeline.create(dai.node.ReplayVideo)
    replay.setReplayVideoFile(folder / VIDEO)
    replay.setReplayMetadataFile(folder / STAMPS)
    replay.setOutFrameType(dai.ImgFrame.Type.GRAY8)
    replay.setLoop(False)
    # as fast as the frames are taken
    replay.setFps(1000)
    numbers = set[int]()
    threads = set[int]()

    def take(message: Any) -> None:
        threads.add(get_native_id())
        numbers.add(message.getSequenceNum())

    replay.out.createOutputQueue(maxSize=1, blocking=False).addCallback(take)
    pipeline.start()
    while pipeline.isRunning():
        time.sleep(POLL_S)
    pipeline.stop()
    # Releasing the pipeline while its threads run waits for them with the interpreter lock held,
    # and they wait for that lock.
    while any(Path(f"/proc/self/task/{thread}").exists() for thread in threads):
        time.sleep(POLL_S)
    return numbers


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
