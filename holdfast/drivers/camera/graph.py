"""The graph: frames -> lossless video, and -> tags -> tags.csv. Only the source differs.

Four properties of depthai shape this code. An error in a callback ends the interpreter, so no
Python that may raise runs in depthai's threads, and answers are pulled. By default inputs drop
frames, so they block here. What is queued when a pipeline stops is lost, so the queues are emptied
first. A video that could not be written raises no error, so it is read again.
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable
from datetime import timedelta
from importlib.metadata import version
from pathlib import Path
from threading import get_native_id
from typing import Any, TextIO

import msgspec

from holdfast.core.errors import (
    DeviceLost,
    HoldfastError,
    OutputError,
)
from holdfast.drivers.camera.recording import (
    ABOUT,
    STAMPS,
    TAGS,
    VIDEO,
    CameraFacts,
    Corners,
    new_tag_file,
    read_tracks,
    write_about,
    write_tags,
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
EMPTY_POLLS = 6
POLL_S = 0.01
STAMP_S = 2e-6
"""depthai keeps stamps to a microsecond."""


def watch(
    source: FrameSource, out: Path, *, stopped: Callable[[], bool] = lambda: False
) -> CameraFacts:
    """Run the graph on a source until it ends or is stopped, and leave a recording in `out`.

    Whatever goes wrong, the recording so far is kept, camera.json says why the trial is void, and
    the error is raised: CameraUnavailable, DeviceLost, TransferFailed, OutputError, or what the
    source raises.
    """
    dai = load_depthai()
    failed: HoldfastError | None = None
    try:
        pipeline = source.open(dai)
        _require_new(out)
        facts = CameraFacts(
            **msgspec.structs.asdict(source.lens),
            source=source.name,
            family=FAMILY,
            quad_decimate=QUAD_DECIMATE,
            void="interrupted",
            depthai=version("depthai"),
        )
        # written first, so that a killed recording says so
        write_about(out, facts)
        try:
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


def _require_new(out: Path) -> None:
    for name in (VIDEO, STAMPS, TAGS, ABOUT):
        if (out / name).exists():
            raise OutputError(
                f"holds {name} already",
                where=out,
                next_step="name a new folder, or remove this one",
            )


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
    frames = len(tracks.sequence)
    in_video_s = stamps_of_video(out, dai)
    facts = msgspec.structs.replace(
        facts,
        frames=frames,
        lost=int(tracks.sequence[-1] - tracks.sequence[0]) + 1 - frames,
        in_video=len(in_video_s),
    )
    ends_s = tracks.t_s + 5e-4 * source.lens.exposure_ms
    required = max(1, frames - source.last_lost)
    missing = 0
    for number, end_s in zip(tracks.sequence[:required], ends_s, strict=False):
        off_s = abs(in_video_s.get(int(number), math.inf) - end_s)
        missing += off_s > STAMP_S
    if not missing:
        return facts, None
    return facts, OutputError(
        f"{missing} of {frames} frames are not in the video",
        where=out / VIDEO,
        cause="a full disk, or a machine too slow for lossless video",
        next_step=f"make room and record again; {TAGS} holds the tracks",
    )


def stamps_of_video(folder: Path, dai: Any) -> dict[int, float]:
    """The frames of a recorded video: their number -> end of exposure, s.

    The end of the file stops depthai's pipeline at once, and a queue that is pulled would lose the
    last frames. So a callback in depthai's own thread takes them.
    """
    if not (folder / VIDEO).is_file():
        return {}
    pipeline = dai.Pipeline(createImplicitDevice=False)
    replay = pipeline.create(dai.node.ReplayVideo)
    replay.setReplayVideoFile(folder / VIDEO)
    replay.setReplayMetadataFile(folder / STAMPS)
    replay.setOutFrameType(dai.ImgFrame.Type.GRAY8)
    replay.setLoop(False)
    # as fast as the frames are taken
    replay.setFps(1000)
    end_s: dict[int, float] = {}
    threads = set[int]()

    def take(message: Any) -> None:
        threads.add(get_native_id())
        end_s[message.getSequenceNum()] = message.getTimestamp().total_seconds()

    replay.out.createOutputQueue(maxSize=1, blocking=False).addCallback(take)
    pipeline.start()
    while pipeline.isRunning():
        time.sleep(POLL_S)
    pipeline.stop()
    # Releasing the pipeline while its threads run waits for them with the interpreter lock held,
    # and they wait for that lock.
    while any(Path(f"/proc/self/task/{thread}").exists() for thread in threads):
        time.sleep(POLL_S)
    return end_s


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
