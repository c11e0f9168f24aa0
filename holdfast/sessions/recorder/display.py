"""What the operator sees during a session: the status line of a terminal.

The line has time, lost samples, and the force on each finger. It is redrawn in place a few
times a second. Nothing waits for it: a terminal that blocks misses updates.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from typing import TextIO

import numpy as np

from holdfast.core.errors import visible_lines
from holdfast.core.source import SourceReading
from holdfast.sessions.recorder.session import Display
from holdfast.sessions.recorder.trial import TrialRecorder

REDRAW_NS = 250_000_000
"""Four times a second: more cannot be read, and costs time between samples."""
COLUMNS = 80
"""Where a terminal does not know its width."""
OVER_THE_LINE_ABOVE = "\x1b[A\r\x1b[2K"
"""Cursor up, first column, erase the line: the next output replaces the line above."""


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
