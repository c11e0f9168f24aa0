"""The camera beside the recorder: one process for each trial, started, watched, and ended."""

from __future__ import annotations

import json
import subprocess
import sys
import time
from contextlib import suppress
from pathlib import Path

from holdfast.core.errors import CameraUnavailable, DataError
from holdfast.core.reading import Json
from holdfast.drivers.camera.recording import TAGS, read_about
from holdfast.sessions.onset import doubt

LONGEST_START_S, LONGEST_END_S = 40.0, 120.0
POLL_S = 0.02
LOG = "camera.log"


class Beside:
    """One camera for one trial at a time; options: of the process, except `out`."""

    def __init__(self, options: Json) -> None:
        self.options = options
        self._folder = Path()
        self._process: subprocess.Popen[bytes] | None = None
        self._lost = False

    def start(self, folder: Path) -> None:
        """Film into a trial's folder; returns when frames arrive. Raises CameraUnavailable."""
        self._folder, self._lost = folder, False
        command = [
            sys.executable,
            "-m",
            "holdfast.sessions.recorder.filming",
            json.dumps({**self.options, "out": str(folder)}),
        ]
        with (folder / LOG).open("wb") as log:
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
            time.sleep(POLL_S)

    def lost(self) -> str:
        """Why the camera process failed, once; empty while it runs or after a normal end."""
        if self._lost or self._process is None or self._process.poll() in (None, 0):
            return ""
        self._lost = True
        return (
            self._last_error() or f"its process ended with {self._process.returncode}"
        )

    def stop(self) -> Json:
        """End it; returns {"void": reason or None, "frames", "lost", "doubt": reason or None}."""
        if self._process is None:
            return {"void": "was not started"}
        if self._process.stdin is not None:
            self._process.stdin.close()
        try:
            self._process.wait(LONGEST_END_S)
        except subprocess.TimeoutExpired:
            self._process.kill()
            self._process.wait()
        failed = self._process.returncode != 0
        self._process = None
        try:
            about = read_about(self._folder)
        except DataError as error:
            return {"void": self._last_error() or str(error)}
        void = about.get("void") or (
            self._last_error() or "its process failed" if failed else None
        )
        wrong = None if void else doubt(self._folder)
        counts = {
            "void": void,
            "frames": about.get("frames"),
            "lost": about.get("lost"),
        }
        return counts | {
            "doubt": None if wrong is None else f"{type(wrong).__name__}: {wrong}"
        }

    def _films(self) -> bool:
        """Whether a frame has been read."""
        try:
            return (self._folder / TAGS).read_bytes().count(b"\n") > 1
        except OSError:
            return False

    def _last_error(self) -> str:
        """The last error in its log."""
        with suppress(OSError):
            lines = (self._folder / LOG).read_text("utf-8", "replace").splitlines()
            return next(
                (
                    line.removeprefix("error: ")
                    for line in reversed(lines)
                    if line.startswith("error: ")
                ),
                "",
            )
        return ""
