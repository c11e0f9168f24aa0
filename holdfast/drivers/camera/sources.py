"""Where frames come from: an OAK camera, or frames on disk (.npz).

The only import of depthai is here: late, and with its telemetry switched off first.
"""

from __future__ import annotations

import os
import time
import zipfile
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from dataclasses import dataclass
from datetime import timedelta
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import (
    CameraUnavailable,
    DataNotFound,
    EmptyRecording,
    TransferFailed,
    needs_extra,
)
from holdfast.core.schema import checked
from holdfast.drivers.camera.recording import Lens, require_forward

Image = npt.NDArray[np.uint8]
OAK = "oak"
OAK_SIZE = (640, 400)
"""One core cannot write lossless video of more pixels at 60 frames a second."""
OAK_ISO = 800
QUEUE = 4
POLL_S = 0.001
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


def load_depthai() -> Any:
    """Import depthai after putting QUIET into the environment. Raises LibraryMissing.

    depthai reads its environment once, when it is imported; a later change has no effect.
    """
    for name, value in QUIET.items():
        # what the user has set stays
        os.environ.setdefault(name, value)
    with needs_extra("camera"):
        return import_module("depthai")


@dataclass(frozen=True)
class Frame:
    """One picture [H, W], its number, and the end of its exposure, s."""

    sequence: int
    end_s: float
    image: Image


class Stored:
    """Frames from disk or from an iterable, through a pipeline without a device.

    last_lost: frames at the end that a stop may cost the video.
    """

    last_lost = 0

    def __init__(self, name: str, lens: Lens, frames: Iterable[Frame]) -> None:
        self.name = name
        self.lens = lens
        self.frames = frames

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


class Oak:
    """An OAK camera on USB, global shutter, fixed exposure, stamps on this machine's clock.

    A camera that falls off the bus does not come back within a trial: the trial is void.
    """

    name = OAK
    last_lost = LOSSLESS_LAST

    def __init__(self, lens: Lens, seconds: float | None = None) -> None:
        self.lens = lens
        self.seconds = float("inf") if seconds is None else seconds
        self.device: Any = None

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
        until_s = time.monotonic() + self.seconds
        return lambda: time.monotonic() < until_s

    def close(self) -> None:
        """Give the camera back."""
        if self.device is not None:
            self.device.close()


FrameSource = Stored | Oak


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
        time.sleep(POLL_S)
    raise TransferFailed(
        "the graph takes no more frames",
        where="depthai",
        cause="a node of the graph stopped",
        next_step="run again with DEPTHAI_LEVEL=info, which logs the reason",
    )


def read_frames(path: Path) -> Stored:
    """Frames of an .npz file, with their stamps and the numbers of the lens.

    The file holds `frames` [K, H, W] uint8, H and W even, `time_s` [K] ends of exposure, fps,
    exposure_ms and tag_mm. Raises DataNotFound, EmptyRecording, TimeError.
    """
    try:
        with path.open("rb") as opened, np.load(opened) as file:
            images, ends_s = file["frames"], file["time_s"]
            numbers = {
                name: float(file[name]) for name in ("fps", "exposure_ms", "tag_mm")
            }
    except FileNotFoundError:
        next_step = "check the path; watch takes oak or a .frames.npz"
        raise DataNotFound("no such file", where=path, next_step=next_step) from None
    except (ValueError, KeyError, EOFError, zipfile.BadZipFile) as error:
        raise EmptyRecording(
            f"cannot be read as frames ({error})",
            where=path,
            next_step="docs/camera.md describes the file",
        ) from None

    lens = checked({**numbers, "clock": "trial"}, Lens, path, EmptyRecording)
    is_grey = images.ndim == 3 and images.dtype == np.uint8 and images.size
    is_odd = any(size % 2 for size in images.shape[1:3])
    if not is_grey or is_odd or ends_s.shape != images.shape[:1]:
        raise EmptyRecording(
            f"frames are {images.dtype} {images.shape} and stamps {ends_s.shape}",
            where=path,
            cause="the pictures are not grey, or a size is odd, which no lossless video has",
            next_step="store frames as uint8 [K, H, W], H and W even, and time_s as [K]",
        )
    require_forward(ends_s, path)
    stamped = zip(ends_s.tolist(), images, strict=True)
    frames = (Frame(k, end_s, image) for k, (end_s, image) in enumerate(stamped))
    return Stored(path.name, lens, frames)
