"""A log of another program as columns: a table has one stream, a bag one for each topic."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray, IntArray, Json

Column = npt.NDArray[Any]
"""[T] numbers, nan for none; or texts as objects, "" for none."""
Columns = dict[str, Column]
FEWEST_ROWS = 10
"""Of a trial."""
GAP_STEPS = 5.0
"""A step of so many usual ones is a gap."""
LOG_TIME = "log_time"
"""The column of a log's own stamps, ns, where it has such."""


@dataclass(frozen=True)
class Stream:
    """Rows of a topic, a sheet or a table. t_ns [T]: the log's own stamps; None without.

    notes: what was left out or changed on reading, a line each.
    """

    columns: Columns
    t_ns: IntArray | None = None
    name: str = ""
    notes: tuple[str, ...] = ()

    @property
    def rows(self) -> int:
        """T."""
        return max(map(len, self.columns.values()), default=0)


@dataclass(frozen=True)
class ForeignLog:
    """One file. name: its path below the source, without its ending.

    about: what a file of `holdfast convert` says of its trial; the unit of messages; the rate and
    the words of units above a table.
    """

    path: Path
    name: str
    streams: tuple[Stream, ...]
    about: Json = field(default_factory=dict)

    @property
    def keys(self) -> set[str]:
        """How a table of events may name it, in small letters; its last number too."""
        names = [self.name, self.path.name, Path(self.name).name]
        numbers = re.findall(r"\d+", self.name)[-1:]
        return {*map(str.casefold, names), *map(str, map(int, numbers))}


def first_stream(log: ForeignLog) -> Stream:
    """The longest stream of a log."""
    return max(log.streams, key=lambda one: one.rows)


def merged(log: ForeignLog) -> Columns:
    """The columns of all streams of a log, each as long as it is."""
    columns: Columns = {}
    for stream in log.streams:
        columns |= stream.columns
    return columns


def text_column(cells: Sequence[Any]) -> Column:
    """Cells as texts, "" for None."""
    texts = ["" if cell is None else str(cell).strip() for cell in cells]
    return np.array(texts, dtype=object)


def is_text(column: Column) -> bool:
    """Whether a column holds texts."""
    return column.dtype.kind not in "iufb"


def text_cells(column: Column) -> list[str]:
    """The cells as texts; a whole number without its point, nan as ""."""
    if is_text(column):
        return [*column]
    # each number once: a long log has many rows and few trials
    numbers, rows = np.unique(column, return_inverse=True)
    texts = [f"{one:.10g}" if np.isfinite(one) else "" for one in numbers.tolist()]
    return [texts[row] for row in rows.tolist()]


def counted(name: str) -> list[Any]:
    """A key by which trial_2 comes before trial_10: texts and numbers in turn."""
    parts = enumerate(re.split(r"(\d+)", name))
    return [int(part) if k % 2 else part for k, part in parts]


# -- an even clock


def unwrapped(stamps: IntArray, unit_ns: float) -> IntArray:
    """Stamps of a counter of 8, 16 or 32 bits that began anew, on one line."""
    back = -np.diff(stamps).min(initial=0)
    for bits in (8, 16, 32):
        period = int(unit_ns * 2.0**bits)
        if 0.9 * period < back < 1.01 * period:
            return np.unwrap(stamps, discont=0.9 * period, period=period).astype(int)

    return stamps


def evened(stamps: IntArray, step: float) -> IntArray:
    """Stamps [T] that arrive in bursts, or far from evenly, on a line through each unbroken run."""
    steps = np.diff(stamps)
    is_even = np.mean(np.abs(steps - step) <= 0.5 * step) > 0.9
    if is_even and (steps > 0).all():
        return stamps
    longest = max(GAP_STEPS * step, 3.0 * float(np.median(steps[steps > 0])))
    lines: list[FloatArray] = []
    for run in np.split(stamps, np.flatnonzero(steps > longest) + 1):
        line = run[0] + step * np.arange(len(run))
        if len(run) > 2 * FEWEST_ROWS:
            line += np.mean(run - line)
        if lines:
            # the line of a run may begin before the one before it ends
            line += max(0.0, lines[-1][-1] + step - line[0])
        lines.append(line)

    return np.round(np.concatenate(lines)).astype(np.int64)
