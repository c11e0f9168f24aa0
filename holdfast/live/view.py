"""`--to view`: the stream in a terminal, also over SSH, on stderr.

A thread draws and writes, so a terminal that blocks stops the picture and nothing else. The library
rich draws it (extra `view`); without rich there is one plain line a second.
"""

from __future__ import annotations

import os
import sys
from collections import deque
from contextlib import suppress
from dataclasses import dataclass
from threading import Event, Thread
from typing import TYPE_CHECKING, NamedTuple, TextIO

import numpy as np

from holdfast.core.contract import (
    NORMAL_AXIS,
    SITUATIONS,
    GripCommand,
    Prediction,
    Sample,
)
from holdfast.core.hand_card import sensor_names
from holdfast.core.lines import STREAM_LINES, STUCK_S, write_whole_line
from holdfast.core.source import SourceReading
from holdfast.live.outputs import STOPPED

if TYPE_CHECKING:
    from rich.console import RenderableType
    from rich.table import Table

    from holdfast.edge_runtime.model_file import ModelCard
    from holdfast.edge_runtime.wearer import Intent, IntentMonitor

REFRESH_S, PLAIN_S = 0.125, 1.0
"""Between two pictures, and between two plain lines."""
NO_RICH = "a picture needs the package rich: pip install 'holdfast[view]'"
BAR = 30
COLOURS = {
    "unknown": "magenta",
    "nothing": "bright_black",
    "grasp": "cyan",
    "safe_slip": "green",
    "risky_slip": "red",
}


class Shown(NamedTuple):
    """What the picture shows. card: of the model; intent: the wearer's, where there is a stream."""

    prediction: Prediction
    sample: Sample
    reading: SourceReading
    card: ModelCard
    intent: Intent | None = None

    @property
    def state(self) -> str:
        """The state with its requests, in words."""
        answer = self.prediction
        # a request to act is above one to arm, so only the stronger one is shown
        request = "  ACT" if answer.act else "  arm" if answer.arm else ""
        missing = "  degraded" if answer.degraded else ""
        return f"{_words(answer.state).upper()}{missing}{request}"


@dataclass
class View:
    """The newest sample as a picture that is redrawn in place, with messages above it.

    card: of the model. intent: the wearer's stream, where there is one.
    """

    card: ModelCard
    terminal: TextIO
    intent: IntentMonitor | None = None

    def __post_init__(self) -> None:
        self._newest: Shown | None = None
        self._messages: deque[str] = deque(maxlen=STREAM_LINES)
        self._done = Event()
        self._thread = Thread(target=self._draw_until_done, name="view", daemon=True)

    def write(
        self,
        prediction: Prediction,
        sample: Sample,
        reading: SourceReading,
        command: GripCommand | None = None,
    ) -> None:
        """Set what the next picture shows."""
        intent = None if self.intent is None else self.intent.newest
        # one assignment: the drawing thread sees all of one sample, or all of the last
        self._newest = Shown(prediction, sample, reading, self.card, intent)

    def report(self, line: str) -> None:
        """Put a message above the picture."""
        self._messages.append(line)

    @property
    def drawing(self) -> bool:
        """Whether messages appear here: only while it runs, on a terminal that is there."""
        return self._thread.is_alive() and not self._done.is_set()

    def start(self) -> None:
        self._thread.start()

    def close(self, reason: str = STOPPED) -> None:
        """Remove the picture; wait at most STUCK_S for a terminal that blocks."""
        self._done.set()
        # a view without a terminal was never started
        if self._thread.is_alive():
            self._thread.join(STUCK_S)

    # -- in the thread

    def _draw_until_done(self) -> None:
        # a terminal that is gone: the sink of stderr notices it too, and reports it
        with suppress(OSError):
            try:
                self._draw_pictures()
            except ModuleNotFoundError:
                self._messages.append(NO_RICH)
                self._write_lines()

    def _draw_pictures(self) -> None:
        from rich.console import Console
        from rich.live import Live

        file = _Whole(self.terminal.fileno())
        console = Console(file=file, force_terminal=True, highlight=False)  # type: ignore[arg-type]
        ended = False
        with Live(console=console, auto_refresh=False, transient=True) as live:
            # Ctrl-Z may come at any moment, and a shell does not show a hidden cursor again.
            console.show_cursor(True)
            while not ended:
                # waiting on the event ends the picture at once when the run ends
                ended = self._done.wait(REFRESH_S)
                for message in self._waiting():
                    console.print(message, markup=False)
                shown = self._newest
                live.update(picture(shown) if shown else "waiting", refresh=True)

    def _write_lines(self) -> None:
        file = _Whole(self.terminal.fileno())
        ended = False
        while not ended:
            ended = self._done.wait(PLAIN_S)
            for message in self._waiting():
                file.write(f"{message}\n")
            if self._newest and not ended:
                risky = self._newest.prediction.p_risky
                file.write(f"{self._newest.state}, p(risky slip) {risky:.2f}\n")

    def _waiting(self) -> list[str]:
        # only those that wait now: the loop may add more meanwhile
        return [self._messages.popleft() for _ in range(len(self._messages))]


class _Whole:
    """A text file without a buffer or a lock that a blocked write would keep."""

    def __init__(self, handle: int) -> None:
        self._handle = handle

    def write(self, text: str) -> None:
        write_whole_line(self._handle, text.encode("utf-8", "replace"))

    def flush(self) -> None:
        """Nothing is kept back."""

    def fileno(self) -> int:
        return self._handle


def open_view(card: ModelCard, terminal: TextIO | None = None) -> View:
    """A view that draws in its thread until it is closed; without a terminal it draws nothing."""
    terminal = terminal or sys.stderr
    view = View(card, terminal)
    # codes for the cursor would only litter a file or a pipe
    if terminal.isatty() and os.environ.get("TERM", "dumb") != "dumb":
        view.start()
    return view


def picture(shown: Shown) -> RenderableType:
    """State and request, the four situations as bars, the sensors, and the wearer's command."""
    from rich.console import Group
    from rich.text import Text

    answer = shown.prediction
    age = f"{1e-3 * answer.latency_us:.1f} ms after it was taken"
    wearer = Text()
    if shown.intent is not None:
        style = COLOURS["unknown"] if shown.intent.wants == "unknown" else ""
        wearer = Text.assemble("wearer  ", (shown.intent.wants, style))
    return Group(
        Text(shown.state, style=f"bold {COLOURS[answer.state]}"),
        Text(f"sample {answer.sequence}, {age}"),
        _situations(shown),
        _sensors(shown),
        wearer,
    )


def _situations(shown: Shown) -> Table:
    """The probability of each as a bar."""
    from rich.progress_bar import ProgressBar
    from rich.table import Table

    table = Table.grid(padding=(0, 1))
    for name in SITUATIONS:
        if name in shown.card.not_learned:
            table.add_row(_words(name), "cannot tell")
            continue
        share = shown.prediction.p_situation[name]
        bar = ProgressBar(1.0, share, BAR, complete_style=COLOURS[name])
        table.add_row(_words(name), bar, f"{share:.2f}")
    return table


def _sensors(shown: Shown) -> Table:
    """Normal force and shear of each sensor, and why one is not valid."""
    from rich.table import Table

    sample, why = shown.sample, shown.reading.why
    names = sensor_names(shown.card.hand, len(sample.valid))
    table = Table(box=None, pad_edge=False, padding=(0, 2, 0, 0))
    unit = shown.card.unit

    for heading in ("sensor", f"normal, {unit}", f"shear, {unit}"):
        table.add_column(heading, justify="right")
    table.add_column(style=COLOURS["unknown"])

    # [S, 3]: x and y along the skin, z along the normal
    forces = sample.values.reshape(-1, 3)
    for k, (name, force) in enumerate(zip(names, forces, strict=True)):
        shear = float(np.hypot(*force[:NORMAL_AXIS]))
        # a sensor that was read well and is not valid still waits for its bias
        trouble = "" if sample.valid[k] else (why[k] if why else "") or "taring"
        table.add_row(name, f"{force[NORMAL_AXIS]:.2f}", f"{shear:.2f}", trouble)
    return table


def _words(name: str) -> str:
    return name.replace("_", " ")
