"""Where frames come from: an OAK camera, or frames on disk (.npz).

The only import of depthai is here: late, and with its telemetry switched off first.
"""

from __future__ import annotations

import math
import os
import sys
import time
import zipfile
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import timedelta
from importlib import import_module
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import (
    CameraUnavailable,
    ColumnError,
    DataNotFound,
    EmptyRecording,
    LibraryMissing,
    TimeError,
    TransferFailed,
)

Image = npt.NDArray[np.uint8]
OAK = "oak"
LENS = ("fps", "exposure_ms", "tag_mm")
OAK_SIZE = (640, 400)
"""One core cannot write lossless video of more pixels at 60 frames a second."""
OAK_ISO = 800
QUEUE = 4
POLL_S = 0.001
LONGEST_WAIT_S = 10.0
SLOWEST_FPS = 0.5
"""depthai takes whole frames a second."""
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
ABSENT = (
    "not plugged in, no USB here, or a cable for power only",
    "lsusb -d 03e7: lists the camera if it is there; try another cable or port",
)
DENIED = (
    "no udev rule for the vendor 03e7",
    "add the rule in docs/camera.md, then unplug the camera and plug it in",
)


def load_depthai(say: Callable[[str], None]) -> Any:
    """Import depthai after putting QUIET into the environment; say so once. Raises LibraryMissing.

    depthai reads its environment once, when it is imported; a later change has no effect.
    """
    if there := sys.modules.get("depthai"):
        return there
    # what the user has set stays, and is reported
    for name, value in QUIET.items():
        os.environ.setdefault(name, value)

    differs = [
        f"{name}={os.environ[name]}"
        for name, value in QUIET.items()
        if os.environ[name] != value
    ]
    kept = f"; your own settings stay: {', '.join(differs)}" if differs else ""
    say(
        f"camera: depthai's usage data are switched off; it looks for cameras on USB only{kept}"
    )
    try:
        return import_module("depthai")
    except ImportError as error:
        raise LibraryMissing(
            f"depthai does not load ({error})",
            where="camera",
            cause="only the extra `camera` installs it",
            next_step="pip install 'holdfast[camera]'",
        ) from None


@contextmanager
def opening() -> Iterator[None]:
    """Turn what depthai raises on the way to a camera into CameraUnavailable."""
    try:
        yield
    except RuntimeError as error:
        text = str(error)
        cause, step = DENIED if "permission" in text.lower() else ABSENT
        raise CameraUnavailable(
            f"no camera ({text})", where="oak", cause=cause, next_step=step
        ) from None


@dataclass(frozen=True)
class Frame:
    """One picture [H, W], its number, and the end of its exposure, s."""

    sequence: int
    end_s: float
    image: Image


@dataclass(frozen=True)
class Lens:
    """What holds for all frames.

    Rate, exposure, printed side of the tags, and the clock of the stamps.

    clock: "monotonic" (this machine's), or "trial" (from the trial's first sample). apart_mm: the
    measured distance between the tags' centres in the first frames, or None.
    """

    fps: float
    exposure_ms: float
    tag_mm: float
    clock: str
    apart_mm: float | None = None

    @classmethod
    def of(cls, numbers: Any, clock: str) -> Lens:
        """From numbers by name.

        Raises ValueError where a number is not positive or fps is below 0.5.
        """
        fps, exposure_ms, tag_mm = (float(numbers[name]) for name in LENS)
        apart_mm = (
            None if numbers.get("apart_mm") is None else float(numbers["apart_mm"])
        )
        positive = [fps - SLOWEST_FPS, exposure_ms, tag_mm]
        if apart_mm is not None:
            positive.append(apart_mm)
        if not all(math.isfinite(number) and number > 0.0 for number in positive):
            raise ValueError(
                f"fps {fps}, exposure_ms {exposure_ms}, tag_mm {tag_mm}, apart_mm {apart_mm}"
            )
        return cls(fps, exposure_ms, tag_mm, clock, apart_mm)


class FrameSource(Protocol):
    """A source of frames. last_lost: frames at the end that a stop may cost the video."""

    name: str
    lens: Lens
    last_lost: int

    def open(self, dai: Any) -> Any:
        """A pipeline without nodes. Raises CameraUnavailable."""

    def connect(
        self, dai: Any, pipeline: Any, inputs: Sequence[Any]
    ) -> Callable[[], bool]:
        """Connect the frames to these inputs.

        Returns a step that passes one frame on; False at the end.
        """

    def close(self) -> None:
        """Release the device, if there is one."""


class Stored:
    """Frames from disk or from an iterable, through a pipeline without a device."""

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
        """Close the generator that the frames come from, if it is one."""
        # a generator may hold a video open
        if isinstance(self.frames, Generator):
            self.frames.close()


class Oak:
    """An OAK camera on USB, global shutter, fixed exposure, stamps on this machine's clock.

    A camera that falls off the bus does not come back within a trial: the trial is void.
    """

    name = OAK
    last_lost = LOSSLESS_LAST

    def __init__(self, lens: Lens, seconds: float | None = None) -> None:
        self.lens = lens
        self.seconds = seconds
        self.device: Any = None

    def open(self, dai: Any) -> Any:
        """Open the first camera found. Raises CameraUnavailable."""
        with opening():
            self.device = dai.Device()
            return self._pipeline(
                dai
            )  # pragma: no cover - from here on a camera is needed

    def _pipeline(self, dai: Any) -> Any:  # pragma: no cover - only with a camera
        self.device.setMaxReconnectionAttempts(0)
        pipeline = dai.Pipeline(self.device)
        pipeline.setStopOnDeviceLoss(True)
        return pipeline

    def connect(  # pragma: no cover - only with a camera; its names are checked against the library
        self, dai: Any, pipeline: Any, inputs: Sequence[Any]
    ) -> Callable[[], bool]:
        """The camera sends frames to the inputs by itself.

        A step only checks whether the time is up.
        """
        with opening():
            camera = pipeline.create(dai.node.Camera).build(sensorFps=self.lens.fps)
            camera.initialControl.setManualExposure(
                round(1e3 * self.lens.exposure_ms), OAK_ISO
            )
            output = camera.requestOutput(
                OAK_SIZE, type=dai.ImgFrame.Type.GRAY8, fps=self.lens.fps
            )
            for one in inputs:
                output.link(one)

        until_s = (
            float("inf") if self.seconds is None else time.monotonic() + self.seconds
        )
        return lambda: time.monotonic() < until_s

    def close(self) -> None:
        """Give the camera back."""
        if self.device is not None:  # pragma: no cover - only with a camera
            self.device.close()


def _message(dai: Any, frame: Frame) -> Any:
    if frame.image.shape[0] % 2 or frame.image.shape[1] % 2:
        raise EmptyRecording(
            f"frames of {frame.image.shape[1]} x {frame.image.shape[0]} pixels",
            where="camera",
            cause="a video with an odd width or height is not lossless",
            next_step="remove one row or column from every frame",
        )

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
    while not _taken(dai, queue, message):
        if not pipeline.isRunning() or time.monotonic() > until_s:
            raise TransferFailed(
                "the graph takes no more frames",
                where="depthai",
                cause="a node of the graph stopped",
                next_step="run again with DEPTHAI_LEVEL=info, which logs the reason",
            )
        time.sleep(POLL_S)


def _taken(dai: Any, queue: Any, message: Any) -> bool:
    """Whether the queue took it; a queue that a stopping graph has closed takes nothing."""
    try:
        return bool(queue.trySend(message))
    except dai.MessageQueue.QueueException:
        return False


def read_frames(path: Path) -> Stored:
    """Frames of an .npz file, with their stamps and the numbers of the lens.

    The file holds `frames` [K, H, W] uint8, `time_s` [K] ends of exposure, and LENS. Raises
    DataNotFound, EmptyRecording, ColumnError, TimeError.
    """
    images, ends_s, lens = _read_arrays(path)
    if (
        images.ndim != 3
        or images.dtype != np.uint8
        or ends_s.shape != images.shape[:1]
        or not images.size
    ):
        raise EmptyRecording(
            f"frames are {images.dtype} {images.shape} and stamps {ends_s.shape}",
            where=path,
            cause="the pictures are not grey, or the stamps are from another recording",
            next_step="store frames as uint8 [K, H, W] and time_s as [K]",
        )

    require_forward(ends_s, path)
    frames = (
        Frame(k, float(end_s), image)
        for k, (end_s, image) in enumerate(zip(ends_s, images, strict=True))
    )
    return Stored(path.name, lens, frames)


def _read_arrays(path: Path) -> tuple[npt.NDArray[Any], npt.NDArray[np.float64], Lens]:
    """`frames`, `time_s` and the lens of an .npz file, with arrays of any type and shape."""
    try:
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            missing = [
                name for name in ("frames", "time_s", *LENS) if name not in file.files
            ]
            if missing:
                raise ColumnError(
                    f"lacks {', '.join(missing)}",
                    where=path,
                    next_step="docs/camera.md describes the file",
                )
            ends_s = np.asarray(file["time_s"], dtype=np.float64)
            return file["frames"], ends_s, Lens.of(file, "trial")
    except FileNotFoundError:
        raise DataNotFound(
            "no such file",
            where=path,
            next_step="check the path; watch takes oak or a .frames.npz",
        ) from None
    except (OSError, ValueError, EOFError, zipfile.BadZipFile) as error:
        raise EmptyRecording(
            f"cannot be read as frames ({type(error).__name__})",
            where=path,
            cause="an interrupted copy, or another file",
            next_step="copy it again, or simulate it again",
        ) from None


def require_forward(ends_s: npt.NDArray[np.float64], where: Path) -> None:
    """Raise TimeError where a stamp is not later than the one before."""
    if not (np.isfinite(ends_s).all() and (np.diff(ends_s) > 0.0).all()):
        raise TimeError(
            "a frame is not later than the frame before",
            where=where,
            cause="a camera driver with wrong stamps",
            next_step="record again",
        )
