"""The operator's status line during a trial: time, rate, lost samples, force on each finger.

It is redrawn in place a few times a second. Nothing waits for it: a terminal that blocks misses
updates.
"""

from __future__ import annotations

import os
from bisect import bisect_left
from collections.abc import Callable
from typing import TextIO

import numpy as np

from holdfast.core.errors import visible_lines
from holdfast.core.source import SourceReading
from holdfast.sessions.recorder.trial import TrialRecorder

REDRAW_NS = 250_000_000
RATE_OVER_NS = 1_000_000_000
COLUMNS = 80
OVER_THE_LINE_ABOVE = "\x1b[A\r\x1b[2K"
"""Cursor up, first column, erase the line: the next output replaces the line above."""
DECIMALS = {"N": 2}


class StatusLine:
    """Draws the line on a sink, and writes messages in its place.

    columns: current width of the terminal, 0 where nothing can be drawn; seconds: length of a
    trial, if set.
    """

    def __init__(
        self,
        sink: Callable[[str], bool],
        columns: Callable[[], int],
        seconds: float | None = None,
    ) -> None:
        self._sink, self._columns = sink, columns
        self._of = "" if seconds is None else f" of {seconds:g}"
        self._drawn = False
        self._due_ns = 0

    def say(self, line: str) -> None:
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
        if columns and self._write(line[: columns - 1]):
            self._drawn = True

    def _write(self, line: str) -> bool:
        return self._sink(f"{OVER_THE_LINE_ABOVE if self._drawn else ''}{line}")


def status_text(trial: TrialRecorder, measured: SourceReading, of: str = "") -> str:
    """The line; forces (or fields) are less the bias, - for a finger that is not valid."""
    unit, bias = trial.quality.unit, np.nan_to_num(trial.quality.bias)
    forces = np.linalg.norm((measured.values - bias).reshape(-1, 3), axis=1)
    fingers = [
        f"{force:5.{DECIMALS.get(unit, 0)}f}" if good else "    -"
        for force, good in zip(forces.tolist(), measured.valid.tolist(), strict=True)
    ]
    return (
        f"{trial.t_s:.1f}{of} s, {_rate(trial.quality.times_ns)} Hz, {trial.quality.lost} lost; "
        f"forces {' '.join(fingers)} {unit}"
    )


def _rate(times_ns: list[int]) -> str:
    """Samples a second over the last second, Hz."""
    first = bisect_left(times_ns, times_ns[-1] - RATE_OVER_NS)
    spent_ns = times_ns[-1] - times_ns[first]
    return f"{1e9 * (len(times_ns) - 1 - first) / spent_ns:.1f}" if spent_ns else "-"


def columns_of(stream: TextIO) -> int:
    """Width of a terminal that can redraw a line; 0 for other streams and lost terminals."""
    if os.environ.get("TERM", "dumb") == "dumb" or not stream.isatty():
        return 0
    try:
        return os.get_terminal_size(stream.fileno()).columns or COLUMNS
    except OSError:
        return 0
