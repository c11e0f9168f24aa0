"""The streams of one log as one table: stamps in one column, a row for each time, one clock."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np

from holdfast.core.column_map import NS_OF
from holdfast.core.contract import FloatArray, IntArray
from holdfast.core.errors import count_of
from holdfast.interop.columns import (
    CLOCK_NS,
    JUDGED_ROWS,
    SECOND_NS,
    find_time,
    is_part_of_second,
)
from holdfast.interop.formats.streams import (
    LOG_TIME,
    Column,
    Columns,
    ForeignLog,
    Stream,
    is_text,
)
from holdfast.interop.formats.tables import pd
from holdfast.interop.words import says, unit_of_time

MOST_KEYS = 100
"""Sensors or axes that rows are of."""
OFTEN, ALIKE, APART = 0.05, 0.5, 1.5
"""So often a column changes that says which one a row is of, so alike its values are many, and so
much more do readings jump across them."""
DEVICE = "(device|board|module|node|sensor|finger|taxel|pad|tip|jaw|hand|side|channel|addr)s?"
"""Words of a column of numbers that may say which one a row is of."""
TWICE = 0.45
"""Of the rows: so many stood before in a log that holds itself twice."""
NEAR_STEPS = 0.6
"""A value of another clock belongs to a row if it is so many steps away."""


def whole_stamps(stream: Stream) -> Stream:
    """Stamps in two columns as one: whole seconds or times of day, and the part of a second."""
    wholes: dict[str, Column] = {}
    parts: dict[str, int] = {}
    for name, column in stream.columns.items():
        unit_ns = NS_OF.get(unit_of_time(name) or "", 0)
        if column.dtype.kind != "i":
            continue
        if is_part_of_second(column, unit_ns):
            parts[name] = unit_ns
        elif unit_ns == SECOND_NS:
            wholes[name] = column * SECOND_NS
        elif column.max() > CLOCK_NS and not (column % SECOND_NS).any():
            wholes[name] = column
    if not len(wholes) == len(parts) == 1:
        return stream
    ((whole, whole_ns),) = wholes.items()
    ((part, unit_ns),) = parts.items()
    columns = {name: one for name, one in stream.columns.items() if name != whole}
    columns[part] = columns[part] + whole_ns // unit_ns
    return replace(stream, columns=columns)


def in_turn(columns: Columns, readings: Columns, clock: str) -> list[str]:
    """The columns of few values that say which sensor or board a row is of.

    They come in turn, or change wherever the clock, "" for none, goes back. Texts, or numbers that
    are called so: other numbers may be flags. Of a text that is not called so the readings are
    other ones, too.
    """
    keys = []
    steps = np.diff(columns[clock]) if clock in columns else np.zeros(0)
    back = np.flatnonzero(steps < 0)
    for name, column in columns.items():
        is_device = says(name, DEVICE)
        if not is_text(column) and not (is_device and column.dtype.kind == "i"):
            continue
        cells = pd.Series(column[column != ""])
        counts = cells.value_counts()
        is_alike = is_text(column) or counts.min() > ALIKE * counts.max()
        often = (cells != cells.shift()).sum() > OFTEN * len(column)
        is_other = is_device and len(back) and (column[back] != column[back + 1]).all()
        # the texts of a short log may all be others
        is_few = 1 < len(counts) <= min(MOST_KEYS, len(cells) // 3)
        is_key = (often or is_other) and is_alike and is_few
        if is_key and (is_device or not readings or _are_apart(readings, column)):
            keys.append(name)
    return keys


def _are_apart(readings: Columns, cells: Column) -> bool:
    """Whether readings jump from cell to cell more than from one row of a cell to its next."""
    values = pd.DataFrame(readings)[:JUDGED_ROWS]
    keys = pd.Series(cells[:JUDGED_ROWS])
    own = values.groupby(keys).diff().abs().mean()
    across = values.diff()[keys != keys.shift()].abs().mean()
    return bool((across > APART * own).any())


def is_twice(columns: Columns, clock: str, axes: Sequence[str]) -> bool:
    """Whether a log whose clock goes back holds all of its rows twice."""
    if not (np.diff(columns[clock]) < 0).any():
        return False
    # of one sensor: a long log is large
    rows = pd.DataFrame({name: columns[name] for name in (clock, *axes[:3])})
    return bool(rows.duplicated().mean() > TWICE)


def is_union(values: FloatArray) -> bool:
    """Whether each row is of one topic, so that none, or few by chance, have all; values [T, C]."""
    there = np.isfinite(values)
    there = there[there.any(axis=1)][:, there.any(axis=0)]
    are_whole = there.all(axis=1)
    if not are_whole.any():
        return True
    # what is lost is seldom lost, or for long
    is_sparse = are_whole.mean() < 0.5 and there.mean() < 0.9
    return bool(is_sparse and np.diff(there, axis=0).mean() > OFTEN)


def without_repeats(stream: Stream) -> Stream:
    """A table without rows that stand twice: the same time, and all else the same."""
    if stream.t_ns is not None:
        return stream
    same = np.ones(stream.rows - 1, dtype=np.bool_)
    for column in stream.columns.values():
        same &= column[1:] == column[:-1]
    time = find_time(stream.columns) if same.any() else None
    if time is None or not time.value.column:
        return stream
    keep = np.append(True, ~same)
    columns = {name: column[keep] for name, column in stream.columns.items()}
    note = f"{count_of(int(same.sum()), 'row')} left out that the one before repeats"
    return replace(stream, columns=columns, notes=(*stream.notes, note))


def united(same: list[Stream]) -> Stream:
    """Streams of the same columns as one.

    One that began anew goes on; of one that was recorded twice the longer is used; sheets get a
    column `sheet` with their names.
    """
    if len(same) == 1:
        return same[0]
    longest = max(same, key=lambda one: one.rows)
    if longest.t_ns is None:
        sheets = [pd.DataFrame(one.columns).assign(sheet=one.name) for one in same]
        return replace(longest, columns=columns_of(pd.concat(sheets)))
    same.sort(key=lambda one: one.t_ns[0])  # type: ignore[index]
    t_ns = np.concatenate([one.t_ns for one in same])
    if (np.diff(t_ns) <= 0).any():
        note = f"{longest.name or 'a stream'} is there twice: the longer one is used"
        return replace(longest, notes=(*longest.notes, note))
    whole = pd.concat([pd.DataFrame(one.columns) for one in same])
    return replace(longest, columns=columns_of(whole), t_ns=t_ns)


def table_of(log: ForeignLog, names: Collection[str]) -> Columns:
    """All columns of the streams that have one of these names, on one clock, with the labels.

    A name that no stream has is left out. The clock is that of the slowest of several streams; what
    was not sent about a row is nan there. Labels of a stream of their own hold until the next one.
    """
    wanted = set(names)
    used = [one for one in log.streams if one.columns.keys() & wanted]
    if not used:
        return {}
    stamps = [one.t_ns for one in used if one.t_ns is not None]
    if len(stamps) < len(used):
        return with_labels(used[0], names)
    # of equally slow streams that which lost the least
    slowest = max(map(step_ns, stamps))
    t_ns = max(stamps, key=lambda one: (step_ns(one) > 0.9 * slowest, len(one)))
    whole = pd.DataFrame({LOG_TIME: t_ns})
    if len(used) == 1:
        whole = whole.assign(**used[0].columns)
    for stream in log.streams:
        if stream.t_ns is None:
            continue
        is_label = not stream.columns.keys() & wanted
        table = {LOG_TIME: stream.t_ns}
        for name, column in stream.columns.items():
            # a label is a text or a whole number
            is_other = is_label and not is_text(column) and (column % 1 > 0).any()
            if name not in whole and not is_other:
                table[name] = column
        if len(table) > 1:
            whole = pd.merge_asof(
                whole.sort_values(LOG_TIME),
                pd.DataFrame(table).sort_values(LOG_TIME, kind="stable"),
                on=LOG_TIME,
                direction="backward" if is_label else "nearest",
                tolerance=None if is_label else max(1, int(NEAR_STEPS * slowest)),
            )
    return columns_of(whole)


def with_labels(stream: Stream, names: Collection[str]) -> Columns:
    """Columns of a table in which what has rows of its own, without readings, holds to the next.

    Such as the labels in a row for each message of any topic. names: of the readings.
    """
    columns = stream.columns
    is_reading = np.zeros(stream.rows, dtype=np.bool_)
    for name in columns.keys() & names:
        is_reading |= np.isfinite(columns[name])
    if is_reading.all():
        return columns
    held = {}
    for name in columns.keys() - names:
        cells = pd.Series(columns[name]).replace("", np.nan)
        if cells[is_reading].isna().all() and cells.notna().any():
            held[name] = cells.ffill()
    return columns | columns_of(pd.DataFrame(held))


def step_ns(stamps: IntArray) -> float:
    """The usual step of stamps [T], 0 of one alone."""
    steps = np.diff(np.unique(stamps))
    return float(np.median(steps)) if len(steps) else 0.0


def columns_of(table: pd.DataFrame) -> Columns:
    """The columns of a table; "" for a text that is not there."""
    columns: Columns = {}
    for name, cells in table.items():
        is_word = is_text(cells.to_numpy())
        columns[str(name)] = (cells.fillna("") if is_word else cells).to_numpy()
    return columns
