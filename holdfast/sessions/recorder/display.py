"""What the operator sees during a session: the status line of a terminal, and the live page.

The line has time, lost samples, and the force on each finger. It is redrawn in place a few
times a second. Nothing waits for either: a terminal or a page that blocks misses updates.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import TextIO

import numpy as np

from holdfast.core.contract import Json
from holdfast.core.errors import visible_lines
from holdfast.core.hand_card import HandCard, read_hand_card
from holdfast.core.source import SourceReading
from holdfast.live.page.link import PageLink, open_page
from holdfast.live.page.run_page import drawn_hand, intent_message
from holdfast.sessions.recorder.keys import Keys
from holdfast.sessions.recorder.plan import RecordOptions
from holdfast.sessions.recorder.session import Display
from holdfast.sessions.recorder.trial import TrialRecorder

REDRAW_NS = 250_000_000
"""Four times a second: more cannot be read, and costs time between samples."""
COLUMNS = 80
"""Where a terminal does not know its width."""
OVER_THE_LINE_ABOVE = "\x1b[A\r\x1b[2K"
"""Cursor up, first column, erase the line: the next output replaces the line above."""
DECIMALS = {"N": 2}
"""Of a force by its unit; fields have none."""
ACTIONS = [
    {"do": "start", "label": "Start", "key": " ", "when": "ready"},
    {"do": "load", "label": "Load onset", "key": "l", "when": "trial"},
    {"do": "released", "label": "Released", "key": "e", "when": "trial"},
    {"do": "keep", "label": "Keep", "key": "k", "when": "trial"},
    {"do": "redo", "label": "Redo", "key": "r", "when": "always"},
    {"do": "stop", "label": "Stop recording", "key": "q", "when": "always"},
]
"""The page's buttons: each presses a key of holdfast/sessions/recorder/keys.py."""


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
    decimals = DECIMALS.get(quality.unit, 0)
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


class RecordPage(Display):
    """A session's messages and samples go to the page, and on to the terminal."""

    def __init__(
        self, link: PageLink, terminal: Display, hand: HandCard | None = None
    ) -> None:
        super().__init__(terminal.report)
        self._link = link
        self._terminal = terminal
        self._hand = hand
        self._task = ""
        self._unit = ""

    def report(self, line: str) -> None:
        """A message."""
        super().report(line)
        self._link.send({"said": line})

    def announce(self, task: str, left: int) -> None:
        """The next trial, before it begins."""
        self._task = task
        self._link.send({"ready": {"task": task, "left": left}})

    def show(self, trial: TrialRecorder, measured: SourceReading, now_ns: int) -> None:
        """One sample, less the bias; nothing waits."""
        quality = trial.quality
        # Unit and number of sensors are known only once the source is open.
        if quality.unit != self._unit:
            self._unit = quality.unit
            hand = drawn_hand(self._hand, len(measured.valid))
            self._link.send({"about": {"unit": self._unit, "hand": hand}})
        values = measured.values - np.nan_to_num(quality.bias)
        sample: Json = {
            "t_ns": now_ns,
            "x": values.tolist(),
            "v": [int(good) for good in measured.valid],
            "why": measured.why,
            "lost": quality.lost,
            "unsent": self._link.unsent,
            "task": self._task,
            "trial_s": round(trial.t_s, 3),
            **intent_message(trial.intent),
        }
        self._link.send({"sample": sample})
        self._terminal.show(trial, measured, now_ns)


@contextmanager
def record_page(
    address: str, options: RecordOptions, keys: Keys, terminal: Display
) -> Iterator[RecordPage]:
    """The page of a recording, served on [HOST:]PORT until its end; its buttons press keys.

    Raises UsageError, CardError, OutputError.
    """
    about: Json = {
        "verb": f"record {options.person}",
        "unit": "",
        "hand": [],
        "source": options.source,
        "answers": False,
        "grip": False,
        "actions": ACTIONS,
    }
    hand = None if options.hand is None else read_hand_card(options.hand)
    link = open_page(address, about, terminal.report)

    end = "the recording failed"
    try:
        keys.listen_to(link.handle)
        yield RecordPage(link, terminal, hand)
        end = "the recording has ended"
    finally:
        link.close(end)
