"""The operator's terminal during a session: keys, one press at a time, and the status line.

The line has time, lost samples, and the force on each finger. It is redrawn in place a few times a
second. Nothing waits for it: a terminal that blocks misses updates. Keys come from a terminal in
cbreak mode (also over SSH), a pipe or a file.
"""

from __future__ import annotations

import os
import select
import sys
import termios
import time
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any, TextIO

import numpy as np

from holdfast.core.errors import visible_lines
from holdfast.core.lines import stream_sink
from holdfast.core.source import SourceReading
from holdfast.live.running import RunClock

if TYPE_CHECKING:
    from holdfast.sessions.recorder.trial import TrialRecorder

KEYS = {
    " ": "begin",
    "\n": "begin",
    "k": "keep",
    "r": "redo",
    "q": "stop",
    "l": "load_onset",
    "e": "contact_lost",
}
ESCAPE = b"\x1b"
HELP_READY = "space begins, r does the last one again, q stops"
HELP_TRIAL = "l load comes on, e released, k keep and next, r redo, q keep and stop"
REDRAW_NS = 250_000_000
"""Four times a second: more cannot be read, and costs time between samples."""
COLUMNS = 80
"""Where a terminal does not know its width."""
OVER_THE_LINE_ABOVE = "\x1b[A\r\x1b[2K"
"""Cursor up, first column, erase the line: the next output replaces the line above."""


class Keys:
    """Keys pressed on a file descriptor; none after its end. handle None: no key can be pressed."""

    def __init__(self, handle: int | None) -> None:
        self._handle = handle
        self._next = b""
        self.last = ""
        """The last letter that `pressed` met, whatever it means."""

    @property
    def closed(self) -> bool:
        """Whether no key can be pressed any more."""
        return self._handle is None and not self._next

    def ended(self) -> bool:
        """`closed` after a look, without waiting, whether the input is at its end; loses no key."""
        self._next = self._next or self._read(0.0)
        return self.closed

    def pressed(self, wait_s: float = 0.0) -> str:
        """The next known key by its name in KEYS, or ""; waits no longer than wait_s."""
        letter = self.letter(wait_s)
        self.last = letter or self.last
        return KEYS.get(letter, "")

    def letter(self, wait_s: float = 0.0) -> str:
        """The next key as a small letter, or ""; an arrow key, which ends in a letter, is none."""
        byte = self.byte(wait_s)
        if byte == ESCAPE:
            # What came with it, such as the rest of an arrow key.
            while self.byte():
                pass
            return ""
        return byte.decode("ascii", "replace").lower()

    def byte(self, wait_s: float = 0.0) -> bytes:
        """The next byte that was typed, or b""; waits no longer than wait_s."""
        byte = self._next or self._read(wait_s)
        self._next = b""
        return byte

    def _read(self, wait_s: float) -> bytes:
        """The next byte; empty if none came in that time, or at the end of the input."""
        if self._handle is None or not select.select([self._handle], [], [], wait_s)[0]:
            return b""
        try:
            byte = os.read(self._handle, 1)
        except OSError:  # the terminal is gone
            byte = b""
        # An empty read is the end of the input, for good.
        if not byte:
            self._handle = None
        return byte


@contextmanager
def listening(handle: int) -> Iterator[Keys]:
    """Keys of a descriptor.

    A terminal reports single presses within the block, and is then restored. Keys that were pressed
    before the block count. TCSANOW: the others wait for output that a stopped terminal never takes.

    If the terminal belongs to another program (we run in the background), nothing is read from it.
    """
    if not os.isatty(handle):
        yield Keys(handle)
        return
    # A read in the background would stop the whole program (SIGTTIN).
    if os.tcgetpgrp(handle) != os.getpgrp():
        yield Keys(None)
        return

    before = termios.tcgetattr(handle)
    try:
        tty.setcbreak(handle, termios.TCSANOW)
        yield Keys(handle)
    finally:
        with suppress(termios.error):  # the terminal is gone
            termios.tcsetattr(handle, termios.TCSANOW, before)


class Display:
    """What the operator sees of a session; this one passes messages on and shows nothing else."""

    def __init__(self, sink: Callable[[str], object]) -> None:
        self._sink = sink

    def report(self, line: str) -> None:
        """A message that stays."""
        self._sink(line)

    def draw(self, line: str) -> None:
        """A line that the next one replaces."""

    def show(self, trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
        """A sample of a trial when it is written; must return at once."""


class StatusLine(Display):
    """Draws the line on a sink, and writes messages in its place.

    sink: returns whether it took the text. columns: current width of the terminal, 0 where nothing
    can be drawn; seconds: length of a trial, if set.
    """

    def __init__(
        self,
        sink: Callable[[str], bool],
        columns: Callable[[], int],
        seconds: float | None = None,
    ) -> None:
        super().__init__(sink)
        self._columns = columns
        self._of = "" if seconds is None else f" of {seconds:g}"
        self._drawn = False
        self._due_ns = 0

    def report(self, line: str) -> None:
        """Write a message that stays, in place of the status."""
        if self._write(visible_lines(line)):
            self._drawn = False

    def show(self, trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
        """Draw the newest sample of a trial, if it is time to redraw."""
        if now_ns < self._due_ns or not trial.started:
            return
        self._due_ns = now_ns + REDRAW_NS
        self.draw(status_text(trial, measured, self._of))

    def draw(self, line: str) -> None:
        """Draw a line in place of the last one that was drawn; nothing without a terminal."""
        columns = self._columns()
        # One column less: a full line would wrap, and the next redraw would miss half of it.
        if columns and self._write(line[: columns - 1]):
            self._drawn = True

    def _write(self, line: str) -> object:
        return self._sink(f"{OVER_THE_LINE_ABOVE if self._drawn else ''}{line}")


def status_text(trial: TrialRecorder, measured: SourceReading, of: str = "") -> str:
    """The line; forces (or fields) are less the bias, - for a finger that is not valid."""
    quality = trial.quality
    values = measured.values - np.nan_to_num(quality.bias)
    forces = np.linalg.norm(values.reshape(-1, 3), axis=1)
    # fields are large numbers
    decimals = 2 if quality.unit == "N" else 0
    # A finger that is not valid shows a dash: its last force would look like a reading.
    fingers = ""
    for force, good in zip(forces, measured.valid, strict=True):
        fingers += f" {force:5.{decimals}f}" if good else "     -"
    return f"{trial.t_s:.1f}{of} s, {quality.lost} lost; forces{fingers} {quality.unit}"


def columns_of(stream: TextIO) -> int:
    """Width of a terminal that can redraw a line; 0 for other streams and lost terminals."""
    if os.environ.get("TERM", "dumb") == "dumb" or not stream.isatty():
        return 0
    try:
        return os.get_terminal_size(stream.fileno()).columns or COLUMNS
    except OSError:
        return 0


@dataclass(frozen=True)
class RunContext:
    """What surrounds a run: its clock, its operator, and what ends it.

    host_ns: CLOCK_MONOTONIC, ns, which also stamps a camera's frames.
    """

    clock: Any
    keys: Keys
    display: Display
    stopped: Callable[[], bool]
    host_ns: Callable[[], int] = time.monotonic_ns


def context_of(
    keys: Keys, stopped: Callable[[], bool], seconds: float | None
) -> RunContext:
    """A run at this terminal, with the status on stderr. seconds: length of a trial, if set."""
    # A sink: a terminal that stops reading must not stop the recording.
    sink = stream_sink(sys.stderr)
    status = StatusLine(sink, lambda: columns_of(sys.stderr), seconds)
    return RunContext(RunClock(), keys, status, stopped)
