"""A log of another program as columns: a table has one stream, a bag one for each topic.

`ForeignLog.table` joins streams by their stamps: what a topic did not send at a time is nan there.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from datetime import datetime
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.column_map import flat_fields
from holdfast.core.contract import IntArray, Json
from holdfast.core.errors import ColumnError

Column = npt.NDArray[Any]
"""[T] numbers, or texts as objects, "" for none."""
Columns = dict[str, Column]
LOG_TIME = "log_time"
"""The column of a log's own stamps, ns, where it has such."""
MORE_THAN_ONE_GRID = 1.5
"""Stamps of all topics over those of the longest one: above it they are not common stamps."""


@dataclass(frozen=True)
class Stream:
    """Rows of a topic, or of a table. t_ns [T]: the log's own stamps; None without."""

    columns: Columns
    t_ns: IntArray | None = None

    @property
    def rows(self) -> int:
        """T."""
        return len(next(iter(self.columns.values()))) if self.columns else 0


@dataclass(frozen=True)
class ForeignLog:
    """One file. name: its path below the source, without its ending.

    about: what a file of `holdfast convert` says of its trial. first_line: of the file, where the
    first row stands.
    """

    path: Path
    name: str
    streams: tuple[Stream, ...]
    about: Json = field(default_factory=dict)
    first_line: int = 1

    @property
    def names(self) -> list[str]:
        """All columns."""
        names = [LOG_TIME] if self.stamped else []
        return names + [name for stream in self.streams for name in stream.columns]

    @property
    def stamped(self) -> bool:
        """Whether the log has stamps of its own."""
        return any(stream.t_ns is not None for stream in self.streams)

    def stream_of(self, name: str) -> Stream | None:
        """The stream with this column."""
        for stream in self.streams:
            if name in stream.columns:
                return stream
        return None

    def table(self, names: Iterable[str]) -> Columns:
        """Columns of one length: those of all streams that have one of these names.

        A name that no stream has is left out. Raises ColumnError for streams without stamps.
        """
        wanted = set(names)
        used = [one for one in self.streams if wanted & one.columns.keys()]
        if not used:
            used = [max(self.streams, key=lambda one: one.rows)] if self.streams else []
        if len(used) > 1:
            return _joined(used, wanted, self.path)
        columns = dict(used[0].columns) if used else {}
        if used and used[0].t_ns is not None:
            columns[LOG_TIME] = used[0].t_ns
        return columns


def _joined(streams: Sequence[Stream], wanted: set[str], path: Path) -> Columns:
    """The wanted columns on common stamps: all of them, or those of the longest stream."""
    stamps = [one.t_ns for one in streams if one.t_ns is not None]
    if len(stamps) < len(streams):
        raise ColumnError(
            "columns of several tables, which have no stamps to join them by",
            where=path,
            next_step="join the tables first",
        )
    longest = max(stamps, key=len)
    grid = np.unique(np.concatenate(stamps))
    if len(grid) > MORE_THAN_ONE_GRID * len(longest):
        grid = np.unique(longest)

    near_ns = int(np.median(np.diff(grid))) // 2 if len(grid) > 1 else 0
    columns: Columns = {LOG_TIME: grid}
    for stream, t_ns in zip(streams, stamps, strict=True):
        if not len(t_ns):
            continue
        order = np.argsort(t_ns, kind="stable")
        nearest = order[_nearest(t_ns[order], grid)]
        there = np.abs(t_ns[nearest] - grid) <= near_ns
        for name in wanted & stream.columns.keys():
            columns[name] = _where_there(stream.columns[name][nearest], there)
    return columns


def _nearest(t_ns: IntArray, grid: IntArray) -> IntArray:
    """[G] the index of the stamp next to each of the grid's; t_ns sorted."""
    after = np.clip(np.searchsorted(t_ns, grid), 1, max(1, len(t_ns) - 1))
    after = np.minimum(after, len(t_ns) - 1)
    before = np.maximum(after - 1, 0)
    is_after = np.abs(t_ns[after] - grid) < np.abs(t_ns[before] - grid)
    nearest: IntArray = np.where(is_after, after, before)
    return nearest


def _where_there(column: Column, there: npt.NDArray[np.bool_]) -> Column:
    """The column, nan or "" where nothing was sent."""
    if column.dtype == object:
        return np.where(there, column, "")
    return np.where(there, column.astype(np.float64), np.nan)


def columns_of(messages: Sequence[Any], prefix: str) -> Columns:
    """Columns of messages: nested objects flattened, one name for each number or text.

    Raises ColumnError.
    """
    rows = [flat_fields(message, prefix) for message in messages]
    names = dict.fromkeys(name for row in rows for name in row)
    return {name: column_of([row.get(name) for row in rows]) for name in names}


def column_of(cells: Sequence[Any]) -> Column:
    """Whole numbers as int64, others as float64 with nan for None; else texts, "" for None.

    Dates with a time of day are ns since 1970.
    """
    kinds = {type(cell) for cell in cells}
    if kinds <= {int}:
        try:
            return np.array(cells, dtype=np.int64)
        except OverflowError:
            return np.array(cells, dtype=np.float64)
    if kinds == {datetime}:
        # a spreadsheet's dates have no time zone
        return np.array(cells, dtype="datetime64[ns]").astype(np.int64)
    if kinds <= {int, float, bool, type(None)}:
        return np.array(cells, dtype=np.float64)
    texts = ["" if cell is None else str(cell) for cell in cells]
    return np.array(texts, dtype=object)


def is_text(column: Column) -> bool:
    """Whether a column holds texts."""
    return column.dtype.kind not in "iufb"


def text_cells(column: Column) -> list[str]:
    """The cells as texts; a whole number without its point, nan as ""."""
    if is_text(column):
        return [str(cell) for cell in column.tolist()]
    cells = []
    for cell in column.tolist():
        if isinstance(cell, float) and not np.isfinite(cell):
            cells.append("")
        elif float(cell).is_integer():
            cells.append(str(int(cell)))
        else:
            cells.append(f"{cell:.10g}")
    return cells


def numeric(columns: Mapping[str, Column]) -> Columns:
    """The columns of numbers."""
    return {name: column for name, column in columns.items() if not is_text(column)}
