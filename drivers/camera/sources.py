"""Where frames come from: an OAK camera, frames on disk (.npz), a recorded folder. The graph behind
is the same."""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Generator, Iterable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from pathlib import Path
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from drivers.camera.library import opening
from edge_runtime.archives import NOT_AN_ARCHIVE, require_modest_archive
from edge_runtime.errors import ColumnError, DataNotFound, EmptyRecording, TimeError, TransferFailed

Image = npt.NDArray[np.uint8]
OAK = "oak"
LENS = ("fps", "exposure_ms", "tag_mm")
OAK_SIZE = (640, 400)
"""Lossless video of more pixels at 60 frames a second does not fit one core."""
OAK_ISO = 800
QUEUE = 4
POLL_S = 0.001
LONGEST_WAIT_S = 10.0
SLOWEST_FPS = 0.5
"""depthai takes whole frames a second."""
LOSSLESS_LAST = 20
"""A camera goes on filming while it is stopped: so many frames at the end may have tags and no
picture."""


@dataclass(frozen=True)
class Frame:
    """One picture [H, W]: its number, and the end of its exposure, s."""

    sequence: int
    end_s: float
    image: Image


@dataclass(frozen=True)
class Lens:
    """What holds for all frames: fps, exposure, printed side of the tags, and whose clock the
    stamps are.

    clock: "monotonic" (this machine's), or "trial" (from the trial's first sample). apart_mm:
    between the tags' centres in the first frames, if somebody measured it.
    """

    fps: float
    exposure_ms: float
    tag_mm: float
    clock: str
    apart_mm: float | None = None

    @classmethod
    def of(cls, told: Any, clock: str) -> Lens:
        """From numbers by name. Raises ValueError where one is not positive, or there is less than
        a frame a second."""
        fps, exposure_ms, tag_mm = (float(told[name]) for name in LENS)
        apart_mm = None if told.get("apart_mm") is None else float(told["apart_mm"])
        numbers = (fps - SLOWEST_FPS, exposure_ms, tag_mm, 1.0 if apart_mm is None else apart_mm)
        if not all(math.isfinite(number) and number > 0.0 for number in numbers):
            raise ValueError(
                f"fps {fps}, exposure_ms {exposure_ms}, tag_mm {tag_mm}, apart_mm {apart_mm}"
            )
        return cls(fps, exposure_ms, tag_mm, clock, apart_mm)


class Source(Protocol):
    """A place frames come from. last_lost: frames at the end that a stop may cost the video."""

    name: str
    lens: Lens
    last_lost: int

    def open(self, dai: Any) -> Any:
        """A pipeline without nodes. Raises CameraUnavailable."""

    def connect(self, dai: Any, pipeline: Any, inputs: Sequence[Any]) -> Callable[[], bool]:
        """Lead the frames to inputs of nodes; what it returns passes on the next one, and is False
        at the end."""

    def close(self) -> None:
        """Let go of the device, if there is one."""


class Stored:
    """Frames that are there already, or that somebody makes, through a pipeline without a
    device."""

    last_lost = 0

    def __init__(self, name: str, lens: Lens, frames: Iterable[Frame]) -> None:
        self.name, self.lens, self.frames = name, lens, frames

    def open(self, dai: Any) -> Any:
        """A pipeline that has no device and looks for none."""
        return dai.Pipeline(createImplicitDevice=False)

    def connect(self, dai: Any, pipeline: Any, inputs: Sequence[Any]) -> Callable[[], bool]:
        """One queue an input; each step puts one frame into all of them, from our thread."""
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
        """Let go of what the frames are read from."""
        if isinstance(self.frames, Generator):
            self.frames.close()


class Oak:
    """An OAK camera on USB, global shutter, exposure fixed by hand; frames are stamped on this
    machine's clock.

    A camera that falls off the bus does not come back within a trial: the trial is void.
    """

    name, last_lost = OAK, LOSSLESS_LAST

    def __init__(self, lens: Lens, seconds: float | None = None) -> None:
        self.lens, self.seconds = lens, seconds
        self.device: Any = None

    def open(self, dai: Any) -> Any:
        """Open the first camera found. Raises CameraUnavailable."""
        with opening():
            self.device = dai.Device()
            return self._pipeline(dai)  # pragma: no cover - from here on a camera is needed

    def _pipeline(self, dai: Any) -> Any:  # pragma: no cover - only with a camera
        self.device.setMaxReconnectionAttempts(0)
        pipeline = dai.Pipeline(self.device)
        pipeline.setStopOnDeviceLoss(True)
        return pipeline

    def connect(  # pragma: no cover - only with a camera; its names are checked against the library
        self, dai: Any, pipeline: Any, inputs: Sequence[Any]
    ) -> Callable[[], bool]:
        """Frames go from the camera to the inputs by themselves; a step only asks whether the time
        is up."""
        with opening():
            camera = pipeline.create(dai.node.Camera).build(sensorFps=self.lens.fps)
            camera.initialControl.setManualExposure(round(1e3 * self.lens.exposure_ms), OAK_ISO)
            output = camera.requestOutput(OAK_SIZE, type=dai.ImgFrame.Type.GRAY8, fps=self.lens.fps)
            for one in inputs:
                output.link(one)
        until_s = float("inf") if self.seconds is None else time.monotonic() + self.seconds
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
            cause="video of an odd width or height is not lossless",
            next_step="cut a row or column off every frame",
        )
    message = dai.ImgFrame()
    message.setType(dai.ImgFrame.Type.GRAY8)
    message.setSize(frame.image.shape[1], frame.image.shape[0])
    message.setData(np.ascontiguousarray(frame.image).ravel())
    message.setSequenceNum(frame.sequence)
    for stamp in (message.setTimestamp, message.setTimestampDevice):
        stamp(timedelta(seconds=frame.end_s))
    return message


def _put(dai: Any, queue: Any, message: Any, pipeline: Any) -> None:
    """Wait for room; TransferFailed where the graph has stopped or takes nothing for ten
    seconds."""
    until_s = time.monotonic() + LONGEST_WAIT_S
    while not _taken(dai, queue, message):
        if not pipeline.isRunning() or time.monotonic() > until_s:
            raise TransferFailed(
                "the graph takes no more frames",
                where="depthai",
                cause="a node of it stopped",
                next_step="again with DEPTHAI_LEVEL=info, which says why",
            )
        time.sleep(POLL_S)


def _taken(dai: Any, queue: Any, message: Any) -> bool:
    """Whether there was room; a queue that a stopping graph has closed has none."""
    try:
        return bool(queue.trySend(message))
    except dai.MessageQueue.QueueException:
        return False


def read_frames(path: Path) -> Stored:
    """Frames of a scene or of anybody: `frames` [K, H, W] uint8, `time_s` [K] ends of exposure, and
    the lens's numbers.

    Raises DataNotFound, EmptyRecording, ColumnError, TimeError.
    """
    try:
        require_modest_archive(path)
        with path.open("rb") as opened, np.load(opened, allow_pickle=False) as file:
            missing = [name for name in ("frames", "time_s", *LENS) if name not in file.files]
            if missing:
                raise ColumnError(
                    f"no {', '.join(missing)}",
                    where=path,
                    next_step="docs/camera.md says what is in it",
                )
            images, ends_s = file["frames"], np.asarray(file["time_s"], dtype=np.float64)
            lens = Lens.of(file, "trial")
    except FileNotFoundError:
        raise DataNotFound("no such file", where=path, next_step="check the path") from None
    except NOT_AN_ARCHIVE as error:
        raise EmptyRecording(
            f"cannot be read as frames ({type(error).__name__})",
            where=path,
            cause="an interrupted copy, or another file",
            next_step="copy it again, or simulate it again",
        ) from None
    if (
        images.ndim != 3
        or images.dtype != np.uint8
        or ends_s.shape != images.shape[:1]
        or not images.size
    ):
        raise EmptyRecording(
            f"frames are {images.dtype} {images.shape} and stamps {ends_s.shape}",
            where=path,
            cause="pictures and stamps of different recordings, or not grey",
            next_step="uint8 [K, H, W] and [K]",
        )
    require_forward(ends_s, path)
    frames = (
        Frame(k, float(end_s), image)
        for k, (end_s, image) in enumerate(zip(ends_s, images, strict=True))
    )
    return Stored(path.name, lens, frames)


def require_forward(ends_s: npt.NDArray[np.float64], where: Path) -> None:
    """Raise TimeError where a stamp is not later than the one before."""
    if not (np.isfinite(ends_s).all() and (np.diff(ends_s) > 0.0).all()):
        raise TimeError(
            "frames stand still or run backwards in time",
            where=where,
            cause="a driver that stamps wrongly",
            next_step="record again",
        )
