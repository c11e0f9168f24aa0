"""`holdfast run --view`: the stream in a terminal, also over SSH, on stderr.

A separate thread draws and writes, so a terminal that blocks stops the picture and nothing else.
It needs no package, so it works where only the live path is installed.
"""

from __future__ import annotations

import os
import sys
from collections import deque
from collections.abc import Collection, Sequence
from threading import Event, Thread
from typing import NamedTuple, TextIO

import numpy as np

from holdfast.core.contract import NORMAL_AXIS, SITUATIONS, Prediction, Sample
from holdfast.core.lines import STREAM_LINES, STUCK_S, write_whole_line
from holdfast.core.source import SourceReading
from holdfast.edge_runtime.intent import Intent, IntentMonitor
from holdfast.live.outputs import STOPPED

REFRESH_HZ = 8
BAR = 30
COLOURS = {
    "unknown": "35",
    "nothing": "90",
    "grasp": "36",
    "safe_slip": "32",
    "risky_slip": "31",
}
"""Magenta, grey, cyan, green and red, by their numbers in ECMA-48 (ANSI)."""
BOLD = "1"
PLAIN = "\x1b[0m"
NAME_WIDTH = max(map(len, SITUATIONS))
WIDTHS = (12, 11)
"""Of the columns of numbers."""
SMALLEST = os.terminal_size((80, 24))
"""Taken where a terminal does not say how large it is."""
CLEAR_LINE = "\x1b[K"
CLEAR_BELOW = "\x1b[J"


class Span(NamedTuple):
    """A piece of a line in one style; style: numbers of ECMA-48, "" for none."""

    text: str
    style: str = ""


Line = list[Span]


class View:
    """The newest sample as a picture that is redrawn in place, with messages above it."""

    def __init__(
        self,
        unit: str,
        terminal: TextIO,
        untold: Collection[str] = (),
        names: Sequence[str] = (),
    ) -> None:
        self._unit = unit
        self._untold = untold
        self._names = names
        self._terminal = terminal
        self._newest: tuple[Prediction, Sample, SourceReading] | None = None
        self._messages: deque[str] = deque(maxlen=STREAM_LINES)
        self.intent: IntentMonitor | None = None
        self._height = 0
        self._done = Event()
        self._thread = Thread(target=self._draw_until_done, name="view", daemon=True)

    def write(
        self, prediction: Prediction, sample: Sample, reading: SourceReading
    ) -> None:
        """Set what the next picture shows."""
        # one assignment: the drawing thread sees all of one sample, or all of the last
        self._newest = (prediction, sample, reading)

    def report(self, line: str) -> None:
        """Put a message above the picture."""
        self._messages.append(line)

    @property
    def drawing(self) -> bool:
        """Whether messages appear here: only while it runs, on a terminal that is there."""
        return self._thread.is_alive() and not self._done.is_set()

    def start(self) -> None:
        """Begin to draw."""
        self._thread.start()

    def close(self, reason: str = STOPPED) -> None:
        """Remove the picture; wait at most STUCK_S for a terminal that blocks."""
        self._done.set()
        # a view without a terminal was never started
        if self._thread.is_alive():
            self._thread.join(STUCK_S)

    def _draw_until_done(self) -> None:
        try:
            # waiting on the event ends the picture at once when the run ends
            while not self._done.wait(1.0 / REFRESH_HZ):
                self._write(self._frame(self._picture()))
            self._write(self._frame([]))
        except OSError:
            return  # the terminal is gone: the sink of stderr notices it too, and reports it

    def _write(self, text: str) -> None:
        write_whole_line(self._terminal.fileno(), text.encode("utf-8", "replace"))

    def _picture(self) -> list[Line]:
        if self._newest is None:
            return [[Span("waiting for the first sample")]]
        wearer = None if self.intent is None else self.intent.newest
        prediction, sample, reading = self._newest
        return picture(
            prediction, sample, reading, self._unit, wearer, self._untold, self._names
        )

    def _frame(self, lines: list[Line]) -> str:
        """The codes and lines that overwrite the last picture."""
        # only those that wait now: the loop may add more meanwhile
        messages = [self._messages.popleft() for _ in range(len(self._messages))]
        size = terminal_size(self._terminal)
        # a picture that is higher than the terminal would scroll, and leave its top behind
        shown = lines[: size.lines - 1]
        # back to the first column, and up by the lines of the last picture
        frame = f"\r\x1b[{self._height}A" if self._height else ""
        self._height = len(shown)
        for message in messages:
            frame += f"{CLEAR_LINE}{message}\n"
        for line in shown:
            frame += f"{CLEAR_LINE}{drawn(line, size.columns)}\n"
        return frame + CLEAR_BELOW


def open_view(
    unit: str,
    *,
    terminal: TextIO | None = None,
    untold: Collection[str] = (),
    names: Sequence[str] = (),
) -> View:
    """A view that draws in its thread until it is closed; without a terminal it draws nothing.

    untold: what the model cannot tell. names: of the sensors, by their hand card.
    """
    terminal = terminal or sys.stderr
    view = View(unit, terminal, untold, names)
    # codes for the cursor would only litter a file or a pipe
    if terminal.isatty() and os.environ.get("TERM", "dumb") != "dumb":
        view.start()
    return view


def terminal_size(terminal: TextIO) -> os.terminal_size:
    """Its columns and lines now; a window may change while it is drawn on."""
    try:
        size = os.get_terminal_size(terminal.fileno())
    except OSError:
        return SMALLEST
    # a serial console reports zeros
    return size if size.columns and size.lines else SMALLEST


def drawn(line: Line, columns: int) -> str:
    """A line as text with its codes, cut to the width: a wrapped line would count as two."""
    text = ""
    for span in line:
        piece = span.text[:columns]
        columns -= len(piece)
        text += f"\x1b[{span.style}m{piece}{PLAIN}" if span.style and piece else piece
    return text


def picture(
    prediction: Prediction,
    sample: Sample,
    measured: SourceReading,
    unit: str,
    intent: Intent | None = None,
    untold: Collection[str] = (),
    names: Sequence[str] = (),
) -> list[Line]:
    """State and request, the four situations as bars, the sensors, and the wearer's command.

    untold: what the model cannot tell, which has no bar. names: of the sensors; numbers without.
    """
    # a request to act is above one to arm, so only the stronger one is shown
    request = ""
    if prediction.act:
        request = "  ACT"
    elif prediction.arm:
        request = "  arm"

    state = prediction.state.replace("_", " ").upper()
    style = f"{BOLD};{COLOURS[prediction.state]}"
    missing = "  degraded" if prediction.degraded else ""
    age = f"{1e-3 * prediction.latency_us:.1f} ms after it was taken"

    lines = [
        [Span(f"{state}{missing}{request}", style)],
        [Span(f"sample {prediction.sequence}, {age}")],
    ]
    for name in SITUATIONS:
        if name in untold:
            words = name.replace("_", " ")
            lines.append([Span(f"{words:<{NAME_WIDTH}} cannot tell")])
            continue
        share = prediction.p_situation[name]
        lines.append(_bar(name.replace("_", " "), share, COLOURS[name]))
    lines += _sensors(sample, measured, unit, names)
    if intent is not None:
        lines += _wearer(intent)
    return lines


def _bar(name: str, share: float, style: str = "") -> Line:
    """A share of 0 to 1 as a bar with its number."""
    bar = "█" * round(BAR * share)
    left = " " * (BAR - len(bar))
    return [
        Span(f"{name:<{NAME_WIDTH}} "),
        Span(bar, style),
        Span(f"{left} {share:.2f}"),
    ]


def _sensors(
    sample: Sample, measured: SourceReading, unit: str, names: Sequence[str]
) -> list[Line]:
    """Normal force and shear of each sensor, and why one is not valid."""
    names = names or [str(k + 1) for k in range(len(sample.valid))]
    head = "sensor"
    width = max(len(head), *map(len, names))
    heads = (head.rjust(width), f"normal, {unit}", f"shear, {unit}")
    lines = [[Span(_row(heads))]]
    for k, force in enumerate(sample.values.reshape(-1, 3)):
        x, y = force[:NORMAL_AXIS]
        shear = float(np.hypot(x, y))
        trouble = ""
        if not sample.valid[k]:
            # a sensor that was read well and is not valid still waits for its bias
            why = measured.why[k] if measured.why else ""
            trouble = why or "taring"
        numbers = (names[k].rjust(width), f"{force[NORMAL_AXIS]:.2f}", f"{shear:.2f}")
        line = [Span(_row(numbers))]
        if trouble:
            line.append(Span(f"  {trouble}", COLOURS["unknown"]))
        lines.append(line)
    return lines


def _row(cells: tuple[str, str, str]) -> str:
    """Cells of the table of sensors, right-aligned; the first is as wide as it comes."""
    name, normal, shear = cells
    return f"{name}{normal:>{WIDTHS[0]}}{shear:>{WIDTHS[1]}}"


def _wearer(intent: Intent) -> list[Line]:
    """What the wearer wants."""
    style = COLOURS["unknown"] if intent.wants == "unknown" else ""
    lines = [[Span(f"{'wearer':<{NAME_WIDTH}} "), Span(intent.wants, style)]]
    return lines
