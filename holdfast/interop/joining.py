"""The streams of one log as one table: stamps in one column, a row for each time, one clock."""

from __future__ import annotations

import re
from collections.abc import Collection
from dataclasses import replace
from itertools import pairwise

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import IntArray
from holdfast.core.errors import count_of
from holdfast.interop.columns import (
    CLOCK_NS,
    JUDGED_ROWS,
    TIME_WORDS,
    find_time,
    rise_of,
    unit_of_time,
    words_of,
)
from holdfast.interop.streams import (
    LOG_TIME,
    Column,
    Columns,
    ForeignLog,
    Stream,
    is_text,
    text_cells,
)
from holdfast.interop.tables import pd

MOST_KEYS = 100
"""Sensors or axes that rows are of."""
OFTEN, ALIKE = 0.1, 0.5
"""So often a column changes that says which one a row is of, and so alike its values are many."""
MOST_LONG = 9
"""Columns where sensors have rows of their own: time, sensor, x, y, z and a few others."""
MOSTLY = 0.9
"""So large a share of the steps of a clock go back where the newest row stands first."""
NEAR_STEPS = 0.6
"""A value of another clock belongs to a row if it is so many steps away."""
SHEET = "sheet"
"""The column that names the sheet of a row, where several are one table."""


def whole_stamps(stream: Stream) -> Stream:
    """Stamps in two columns as one of ns: seconds or a clock, and what a second is parted into."""
    columns = dict(stream.columns)
    clocks = [name for name, column in columns.items() if _is_clock(column)]
    for name, column in stream.columns.items():
        seconds = re.sub("(?i)n(ano)?(?=se?cs?$|seconds$)", "", name)
        part_ns = NS_OF.get(unit_of_time(name) or "", 0)
        if seconds != name and seconds in columns:
            columns[name] = column + 10**9 * columns.pop(seconds)
        elif part_ns and len(clocks) == 1 and column.dtype.kind == "i":
            is_part = (column >= 0) & (part_ns * column < 10**9)
            if is_part.all():
                columns[clocks[0]] = columns[clocks[0]] + part_ns * columns.pop(name)

    return replace(stream, columns=columns)


def oldest_first(stream: Stream) -> Stream:
    """A table whose time falls from row to row, turned round."""
    for name, column in stream.columns.items():
        is_time = bool(words_of(name) & TIME_WORDS) and not is_text(column)
        steps = np.diff(column[:JUDGED_ROWS]) if is_time else np.zeros(1)
        if np.count_nonzero(steps < 0) > MOSTLY * len(steps):
            columns = {key: cells[::-1] for key, cells in stream.columns.items()}
            notes = (*stream.notes, f"{name} falls: the rows were turned round")
            return replace(stream, columns=columns, notes=notes)
    return stream


def _is_clock(column: Column) -> bool:
    """Whether a column holds times of day or dates, in ns, without a part of a second."""
    is_ns = column.dtype.kind == "i" and len(column) and column.max() > CLOCK_NS
    return bool(is_ns) and len(np.unique(column)) > 1 and not (column % 10**9).any()


def in_turn(columns: Columns) -> list[str]:
    """The columns of few values that come in turn, such as the sensor that a row is of."""
    keys = []
    for name, column in columns.items():
        cells = column[:JUDGED_ROWS]
        kinds, codes, counts = np.unique(
            text_cells(cells), return_inverse=True, return_counts=True
        )
        is_few = 1 < len(kinds) <= MOST_KEYS
        # of one column of values all rows of a sensor may stand together
        changes = len(columns) == 3 or np.mean(np.diff(codes) != 0) > OFTEN
        are_alike = counts.min() > ALIKE * counts.max()
        if is_few and changes and are_alike and not rise_of(column)[0]:
            keys.append(name)
    return keys


def made_wide(stream: Stream) -> Stream:
    """A table with a row for each sensor or axis at each time as one with a column for each.

    Checked: each time has a row for each. What no time joins stays as it is.
    """
    columns = dict(stream.columns)
    is_long = stream.rows > MOST_KEYS and len(columns) <= MOST_LONG
    time = find_time(columns) if is_long and stream.t_ns is None else None
    at = time.value.column if time else ""
    is_shared = at and not pd.Index(columns[at]).is_unique
    keys = in_turn(columns) if is_shared else []
    if not keys:
        return stream
    table = pd.DataFrame(columns)
    words = table[keys].map(str).agg("_".join, axis=1)
    try:
        wide = table.drop(columns=[at, *keys]).set_index([columns[at], words]).unstack()
    except ValueError:  # a time stands twice for a sensor
        return stream
    columns = {at: wide.index.to_numpy()}
    for (name, word), cells in wide.items():
        is_word = is_text(cells.to_numpy())
        columns[f"{word}_{name}"] = (cells.fillna("") if is_word else cells).to_numpy()
    each = f"a row for each {' and '.join(keys)}: made columns, checked: each time has them all"
    return replace(stream, columns=columns, notes=(*stream.notes, each))


def without_repeats(stream: Stream) -> Stream:
    """A table without rows that stand twice: the same time, and all else the same."""
    same = np.ones(max(0, stream.rows - 1), dtype=np.bool_)
    for column in stream.columns.values():
        same &= column[1:] == column[:-1]
    time = find_time(stream.columns) if same.any() else None
    if stream.t_ns is not None or time is None or not time.value.column:
        return stream
    keep = np.append(True, ~same)
    columns = {name: column[keep] for name, column in stream.columns.items()}
    note = f"{count_of(int(same.sum()), 'row')} left out that the one before repeats"
    return replace(stream, columns=columns, notes=(*stream.notes, note))


def united(same: list[Stream]) -> Stream:
    """Streams of the same columns as one.

    One that began anew goes on; of one that was recorded twice the longer is used; sheets get a
    column with their names.
    """
    if len(same) == 1:
        return same[0]
    longest = max(same, key=lambda one: one.rows)
    tables = [pd.DataFrame(one.columns).assign(**{SHEET: one.name}) for one in same]
    if longest.t_ns is not None:
        tables = [pd.DataFrame(one.columns, index=one.t_ns) for one in same]
        tables.sort(key=lambda table: table.index[0])
        ends = pairwise(tables)
        if any(later.index[0] <= before.index[-1] for before, later in ends):
            note = (
                f"{longest.name or 'a stream'} is there twice: the longer one is used"
            )
            return replace(longest, notes=(*longest.notes, note))
    whole = pd.concat(tables)
    columns = {str(name): column.to_numpy() for name, column in whole.items()}
    t_ns = None if longest.t_ns is None else whole.index.to_numpy()
    return replace(longest, columns=columns, t_ns=t_ns)


def table_of(log: ForeignLog, names: Collection[str]) -> Columns:
    """All columns of the streams that have one of these names, on one clock, with the labels.

    A name that no stream has is left out. The clock is that of the slowest of several streams; what
    was not sent about a row is nan there. Labels of a stream of their own hold until the next one.
    """
    used = [one for one in log.streams if one.columns.keys() & set(names)]
    if not used:
        return {}
    columns = dict(used[0].columns)
    stamps = [one.t_ns for one in used if one.t_ns is not None]
    if len(stamps) < len(used):
        return columns
    # of equally slow streams that which lost the least
    slowest = max(map(step_ns, stamps))
    t_ns = max(stamps, key=lambda one: (step_ns(one) > 0.9 * slowest, len(one)))
    columns[LOG_TIME] = t_ns = t_ns if len(used) == 1 else np.unique(t_ns)
    for stream in log.streams:
        if stream not in used:
            columns = _at(stream, t_ns) | columns
        elif len(used) > 1:
            columns |= _at(stream, t_ns, NEAR_STEPS * slowest)

    return columns


def step_ns(stamps: IntArray) -> float:
    """The usual step of stamps [T], 0 of one alone."""
    steps = np.diff(np.unique(stamps))
    return float(np.median(steps)) if len(steps) else 0.0


def _at(stream: Stream, t_ns: IntArray, reach_ns: float | None = None) -> Columns:
    """The cells of a stream at stamps [T], "" and nan for none: the nearest ones within a reach.

    Without a reach the last ones before, of texts and of whole numbers alone.
    """
    if stream.t_ns is None:
        return {}
    table = pd.DataFrame(stream.columns, index=stream.t_ns).sort_index(kind="stable")
    table = table[~table.index.duplicated("last")]
    if reach_ns is None:
        rows = table.index.get_indexer(t_ns, "pad")
    else:
        rows = table.index.get_indexer(t_ns, "nearest", tolerance=max(1, int(reach_ns)))
    columns: Columns = {}
    for name, column in table.items():
        cells = column.to_numpy()
        none = "" if is_text(cells) else np.nan
        if reach_ns is not None or none == "" or not (cells % 1 > 0).any():
            columns[str(name)] = np.where(rows < 0, none, cells[rows])

    return columns
