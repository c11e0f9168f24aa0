"""A camera beside the recorder: its options, the process that films, and how that is watched.

    python -m holdfast.sessions.camera '{"camera": "oak", "out": "trial_1", ..}'

One process films one trial, on the same monotonic clock as the recorder. It ends when its standard
input does, so it never outlives the recorder; frames from a file are read to their end first.
Errors are written to camera.json and stderr.
"""

from __future__ import annotations

import json
import os
import select
import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import CameraUnavailable, DataError, HoldfastError, UsageError
from holdfast.drivers.camera.graph import OAK, Oak, StoredFrames
from holdfast.drivers.camera.recording import TAGS, Lens, read_about, read_frames
from holdfast.sessions.onset import doubt

if TYPE_CHECKING:
    from holdfast.core.contract import Json

FPS = 60.0
EXPOSURE_MS = 2.0
"""Of an OAK camera, where nothing else is given."""

LONGEST_START_S = 40.0
"""An OAK loads its program over USB before its first frame."""
LONGEST_END_S = 120.0
"""Frames from disk are read to their end; then the process is killed."""
FIRST_FRAME_POLL_S = 0.02

NICE = 5
"""The hand has precedence: it loses samples that are read late; the camera's queues can wait."""
LOG = "camera.log"
"""In the trial's folder: what the process printed."""


@dataclass(frozen=True, kw_only=True)
class CameraOptions:
    """A camera as the user named it. Only an OAK on USB uses the other options.

    camera: oak, or a file; None films nothing. tag_mm: measured side of the printed tags.
    """

    camera: str | None = None
    tag_mm: float | None = None
    fps: float | None = None
    exposure_ms: float | None = None

    def require_camera(self) -> None:
        """Raise UsageError for a camera that cannot film, before the trials begin."""
        if self.camera == OAK and self.tag_mm is None:
            raise UsageError(
                "--tag-mm is missing",
                cause="millimetres are derived from the printed side",
                next_step="measure a tag's black square with a calliper and give --tag-mm 9.96",
            )
        if self.camera not in (None, OAK) and not Path(self.camera).exists():
            raise UsageError(
                f"--camera {self.camera!r}: no such file",
                next_step="oak, or a .frames.npz",
            )

    def shooting(self) -> dict[str, Any]:
        """Frames a second, exposure and side of an OAK camera."""
        return {
            "fps": self.fps or FPS,
            "exposure_ms": self.exposure_ms or EXPOSURE_MS,
            "tag_mm": self.tag_mm,
        }


# -- the recorder's side


class CameraProcess:
    """Films one trial at a time; without a camera it does nothing."""

    def __init__(self, options: CameraOptions) -> None:
        self._options = options
        self._folder = Path()
        self._process: subprocess.Popen[bytes] | None = None

    def start(self, folder: Path) -> None:
        """Film into a trial's folder; returns when frames arrive. Raises CameraUnavailable."""
        self._folder = folder
        if self._options.camera is None:
            return
        about = {"camera": self._options.camera, "out": str(folder)}
        options = json.dumps(about | self._options.shooting())
        command = [sys.executable, "-m", "holdfast.sessions.camera", options]

        with (folder / LOG).open("wb") as log:
            # A group of its own: Ctrl-C is for the recorder, which then ends the camera.
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=log, stderr=log, process_group=0
            )

        until_s = time.monotonic() + LONGEST_START_S
        while not self._films():
            if self._process.poll() not in (None, 0) or time.monotonic() > until_s:
                self.stop()
                raise CameraUnavailable(
                    self._last_error() or "no frame arrived",
                    where="camera",
                    cause="the camera's own error",
                    next_step="correct that, or record without --camera; "
                    f"{LOG} of the discarded trial has all messages",
                )
            time.sleep(FIRST_FRAME_POLL_S)

    def stop(self) -> Json:
        """End it; returns {"void": reason or None, "frames", "lost", "doubt": reason or None}.

        Empty where nothing films.
        """
        process = self._process
        self._process = None
        if process is None:
            return {}
        try:
            # The end of its input is the sign to stop, which also comes if the recorder is killed.
            process.communicate(timeout=LONGEST_END_S)
        except subprocess.TimeoutExpired:
            # The recorder must go on; what was filmed is then void.
            process.kill()
            process.wait()

        # The process knows best why its film is void; its log knows if it died.
        last_error = self._last_error()
        try:
            about = read_about(self._folder)
        except DataError as error:
            return {"void": last_error or str(error)}
        void = about.void
        if process.returncode and not void:
            void = last_error or "its process failed"
        # Checked while the operator can still film again.
        wrong = None if void else doubt(self._folder)

        return {
            "void": void,
            "frames": about.frames,
            "lost": about.lost,
            "doubt": wrong and f"{type(wrong).__name__}: {wrong}",
        }

    def _films(self) -> bool:
        """Whether a frame has been read."""
        try:
            # The first line is the header.
            return (self._folder / TAGS).read_bytes().count(b"\n") > 1
        except OSError:
            return False

    def _last_error(self) -> str:
        """The last error in its log."""
        try:
            log = (self._folder / LOG).read_text("utf-8", "replace")
        except OSError:
            return ""
        errors = [line for line in log.splitlines() if line.startswith("error: ")]
        return errors[-1].removeprefix("error: ") if errors else ""


# -- the process


def film(options: Json) -> None:
    """Film until the recorder closes standard input, or until the frames end."""
    from holdfast.drivers.camera.graph import watch

    os.nice(NICE)
    out = Path(options["out"])

    if options["camera"] == OAK:
        lens = Lens(
            options["fps"],
            options["exposure_ms"],
            options["tag_mm"],
            clock="monotonic",
        )
        watch(Oak(lens), out, stopped=must_end)
    else:
        watch(StoredFrames(*read_frames(Path(options["camera"]))), out)


def must_end() -> bool:
    """Whether the recorder has closed standard input, or has ended."""
    return bool(select.select([sys.stdin], [], [], 0)[0])


def main() -> int:
    """Run the process; an error is one line in its log, which the recorder reads."""
    try:
        film(json.loads(sys.argv[1]))
    except (HoldfastError, OSError) as error:
        sys.stderr.write(f"error: {type(error).__name__}: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main())
