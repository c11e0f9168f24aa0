"""`holdfast run --view`: the stream in a terminal, also over SSH, on stderr.

A separate thread draws and writes, so a terminal that blocks stops the picture and nothing else.
rich's `Live` is not used: its `stop` waits for the drawing thread, which may wait for the terminal.
"""

from __future__ import annotations

from collections import deque
from threading import Event, Thread

import numpy as np
from rich.console import Console, ConsoleRenderable, Group
from rich.table import Table
from rich.text import Text

from holdfast.core.contract import NORMAL_AXIS, SITUATIONS, Prediction, Sample
from holdfast.core.lines import STREAM_LINES, STUCK_S, write_whole_line
from holdfast.core.source import SourceReading
from holdfast.edge_runtime.intent import Intent, IntentMonitor
from holdfast.live.outputs import STOPPED

REFRESH_HZ = 8
BAR = 30
COLOURS = {
    "unknown": "magenta",
    "nothing": "bright_black",
    "grasp": "cyan",
    "safe_slip": "green",
    "risky_slip": "red",
}
CLEAR_LINE = "\x1b[K"
CLEAR_BELOW = "\x1b[J"


class View:
    """The newest sample as a picture that is redrawn in place, with messages above it."""

    def __init__(self, unit: str, console: Console) -> None:
        self._unit = unit
        self._console = console
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
            self._write(self._frame(""))
        except OSError:
            return  # the terminal is gone: the sink of stderr notices it too, and reports it

    def _write(self, text: str) -> None:
        write_whole_line(self._console.file.fileno(), text.encode("utf-8", "replace"))

    def _picture(self) -> str:
        wearer = None if self.intent is None else self.intent.newest
        # drawn into a text first, so that one write replaces the whole picture
        with self._console.capture() as captured:
            if self._newest is None:
                self._console.print("waiting for the first sample")
            else:
                prediction, sample, reading = self._newest
                shown = picture(prediction, sample, reading, self._unit, wearer)
                self._console.print(shown)

        return captured.get()

    def _frame(self, drawn: str) -> str:
        """The codes and lines that overwrite the last picture."""
        # only those that wait now: the loop may add more meanwhile
        messages = [self._messages.popleft() for _ in range(len(self._messages))]
        # a picture that is higher than the terminal would scroll, and leave its top behind
        lines = drawn.splitlines()[: self._console.size.height - 1]
        # back to the first column, and up by the lines of the last picture
        frame = f"\r\x1b[{self._height}A" if self._height else ""
        self._height = len(lines)
        for line in [*messages, *lines]:
            frame += f"{CLEAR_LINE}{line}\n"
        return frame + CLEAR_BELOW


def open_view(unit: str, *, console: Console | None = None) -> View:
    """A view that draws in its thread until it is closed; without a terminal it draws nothing."""
    console = console or Console(stderr=True)
    view = View(unit, console)
    # codes for the cursor would only litter a file or a pipe
    if console.is_terminal and not console.is_dumb_terminal:
        view.start()
    return view


def picture(
    prediction: Prediction,
    sample: Sample,
    measured: SourceReading,
    unit: str,
    intent: Intent | None = None,
) -> Group:
    """State and request, the four situations as bars, the fingers, and the wearer's command."""
    # a request to act is above one to arm, so only the stronger one is shown
    request = ""
    if prediction.act:
        request = "  ACT"
    elif prediction.arm:
        request = "  arm"

    state = prediction.state.replace("_", " ").upper()
    style = f"bold {COLOURS[prediction.state]}"
    missing = "  degraded" if prediction.degraded else ""
    head = Text(f"{state}{missing}{request}", style=style)
    age = f"{1e-3 * prediction.latency_us:.1f} ms after it was taken"
    sample_line = Text(f"sample {prediction.sequence}, {age}")

    bars = Table.grid(padding=(0, 1))
    for name in SITUATIONS:
        share = prediction.p_situation[name]
        bar = Text("█" * round(BAR * share), style=COLOURS[name])
        bars.add_row(name.replace("_", " "), bar, f"{share:.2f}")

    fingers = _fingers(sample, measured, unit)
    shown: list[ConsoleRenderable] = [head, sample_line, bars, fingers]
    if intent is not None:
        shown.append(_wearer(intent))
    return Group(*shown)


def _fingers(sample: Sample, measured: SourceReading, unit: str) -> Table:
    """Normal force and shear of each finger, and why one is not valid."""
    fingers = Table(box=None, padding=(0, 1))
    for column in ("finger", f"normal, {unit}", f"shear, {unit}", ""):
        fingers.add_column(column, justify="right")

    for k, force in enumerate(sample.values.reshape(-1, 3)):
        x, y = force[:NORMAL_AXIS]
        shear = float(np.hypot(x, y))
        trouble = ""
        if not sample.valid[k]:
            # a finger that was read well and is not valid still waits for its bias
            why = measured.why[k] if measured.why else ""
            trouble = why or "taring"
        fingers.add_row(
            str(k + 1),
            f"{force[NORMAL_AXIS]:.2f}",
            f"{shear:.2f}",
            Text(trouble, style="magenta"),
        )

    return fingers


def _wearer(intent: Intent) -> Table:
    """What the wearer wants, and the envelopes as bars."""
    rows = Table.grid(padding=(0, 1))
    style = COLOURS["unknown"] if intent.wants == "unknown" else ""
    rows.add_row("wearer", Text(intent.wants or "not in words", style=style))
    for k, share in enumerate(intent.envelope, start=1):
        rows.add_row(f"envelope {k}", Text("█" * round(BAR * share)), f"{share:.2f}")
    return rows
