"""`holdfast run --view`: the stream in a terminal, also over SSH. On stderr, so that stdout stays JSON lines."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

import numpy as np
from rich.console import Console, Group
from rich.live import Live
from rich.table import Table
from rich.text import Text

from edge_runtime.contract import NORMAL_AXIS, SITUATIONS, Prediction, Sample
from edge_runtime.live import Measured

REFRESH_HZ = 8
BAR = 30
COLOURS = {"unknown": "magenta", "nothing": "bright_black", "grasp": "cyan", "safe_slip": "green", "risky_slip": "red"}
Newest = tuple[Prediction, Sample, Measured]


@contextmanager
def viewed(unit: str, *, console: Console | None = None) -> Iterator[Callable[[Prediction, Sample, Measured], None]]:
    """What shows the newest sample, until the end; drawn beside the loop, never in it."""
    newest: list[Newest] = []

    def show(prediction: Prediction, sample: Sample, measured: Measured) -> None:
        newest[:] = [(prediction, sample, measured)]

    def drawn() -> Group | Text:
        return picture(*newest[0], unit) if newest else Text("waiting for the first sample")

    with Live(
        get_renderable=drawn, console=console or Console(stderr=True), refresh_per_second=REFRESH_HZ, transient=True
    ):
        yield show


def picture(prediction: Prediction, sample: Sample, measured: Measured, unit: str) -> Group:
    """State and request, the four situations as bars, and every finger with what is wrong with it."""
    request = "  ACT" if prediction.act else "  arm" if prediction.arm else ""
    style = f"bold {COLOURS[prediction.state]}"
    head = Text(f"{prediction.state.replace('_', ' ').upper()}{request}", style=style)
    told = Text(f"sample {prediction.sequence}, {1e-3 * prediction.latency_us:.1f} ms after it was taken")
    bars = Table.grid(padding=(0, 1))
    for name in SITUATIONS:
        share = prediction.p_situation[name]
        bars.add_row(name.replace("_", " "), Text("█" * round(BAR * share), style=COLOURS[name]), f"{share:.2f}")
    fingers = Table(box=None, padding=(0, 1))
    for column in ("finger", f"normal, {unit}", f"shear, {unit}", ""):
        fingers.add_column(column, justify="right")
    by_finger = sample.values.reshape(-1, 3)
    for k, (force, good) in enumerate(zip(by_finger, sample.valid, strict=True)):
        shear = float(np.hypot(*force[:NORMAL_AXIS]))
        why = measured.why[k] if measured.why else ""
        trouble = "" if good else why or "taring"
        fingers.add_row(str(k + 1), f"{force[NORMAL_AXIS]:.2f}", f"{shear:.2f}", Text(trouble, style="magenta"))
    return Group(head, told, bars, fingers)
