"""Text tables by pandas: any separator, decimal sign, encoding, comments, names anywhere on top.

Lines that pandas cannot read as they stand (a time of arrival in front, vectors in brackets, more
cells than names) are made plain first, and those that are left out are counted.
"""

from __future__ import annotations

import codecs
import csv
import re
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np

from holdfast.core.column_map import flat_fields
from holdfast.core.errors import ColumnError, count_of, needs_extra
from holdfast.interop.formats.layout import (
    COMMENTS,
    MISSING,
    SPACES,
    STAMP,
    THOUSANDS,
    TableLayout,
    layout_of,
)
from holdfast.interop.formats.streams import (
    Column,
    Columns,
    ForeignLog,
    Stream,
    is_text,
)

with needs_extra("train"):
    import pandas as pd

HEAD_BYTES, HEAD_LINES = 128 << 10, 240
"""Of the beginning, from which the layout is found."""
CHUNK_ROWS = 20_000
MOST_TORN = 0.2
"""Lines of another number of cells, of all rows, with which a table is none."""
HALF_DAY_NS = 12 * 3600 * 10**9


def begin_of(path: Path) -> tuple[TableLayout, str]:
    """(layout, encoding) of a file. Raises a DataError."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
    encoding = encoding_of(head)
    lines = re.split(r"\r\n?|\n", head.decode(encoding, errors="replace"))
    return layout_of(tuple(lines[:HEAD_LINES])), encoding


def read_log(path: Path, name: str) -> ForeignLog:
    """A file of text as a log of one table. Raises a DataError."""
    layout, encoding = begin_of(path)
    with path.open(encoding=encoding, errors="replace") as file:
        return ForeignLog(path, name, (read_table(file, layout),), layout.about)


def read_table(lines: Iterable[str], layout: TableLayout) -> Stream:
    """The table in lines of text. Raises ColumnError.

    Its rows go through a file, because the cells of a long log as texts would fill the memory.
    """
    with TemporaryFile("w+", encoding="utf-8", newline="") as plain:
        n_rows, notes = _made_plain(lines, plain, layout)
        plain.seek(0)
        cells = _parsed(plain, layout, n_rows)
    return _numeric(cells, layout, notes)


def _made_plain(
    lines: Iterable[str], plain: IO[str], layout: TableLayout
) -> tuple[int, list[str]]:
    """Write the rows of a table as pandas reads them: (how many, notes). Raises ColumnError.

    What stands between the rows is left out, and lines of another number of cells. The table ends
    with an empty line, where what follows is no row of it; a further block goes on with it where
    the heading is the same.
    """
    form, n_names = layout.form, len(layout.names)
    mark = None if form.separator == SPACES else form.separator
    writer = csv.writer(plain, delimiter=form.separator)
    torn: list[str] = []
    others: list[str] = []
    block: list[str] = []
    n_rows, was_empty = 0, False
    for line in islice(lines, layout.first_row, None):
        is_row = layout.is_plain and len(line.split(mark)) == n_names
        # a dot between thousands is to be taken out
        is_dotted = form.thousands == "." in line
        if is_row and not (block or was_empty or is_dotted or line[0] in COMMENTS):
            plain.write(line)
            n_rows += 1
            continue
        text = line.strip(" \t\r\n\0")
        if not text:
            was_empty = True
            continue
        cells = form.cells(line)
        is_comment = text.startswith(COMMENTS)
        is_row = len(cells) == n_names and not is_comment
        is_ours = block[-1] == layout.heading if block else form.share(cells)
        if (block or was_empty) and not (is_row and is_ours):
            block.append(text)
            continue
        others += block
        block, was_empty = [], False
        if is_row:
            writer.writerow(cells)
            n_rows += 1
        elif is_comment or text[0].isalpha():
            others.append(text)
        else:
            torn.append(text)

    if len(torn) > MOST_TORN * n_rows:
        raise ColumnError(
            f"{len(torn)} lines have another number of cells than {n_names}",
            cause="a row that goes on in the next line, or several tables in one file",
            next_step="write each row as one line, and each table as a file",
        )
    kinds = {
        "of another number of cells": torn,
        "between the rows": others,
        "of a second block": block,
    }
    notes = [
        f"{count_of(len(left), 'line')} {what} left out, such as {left[0][:40]!r}"
        for what, left in kinds.items()
        if left
    ]
    return n_rows, notes


def encoding_of(head: bytes) -> str:
    """UTF-16 by its mark, else UTF-8, else that of Western Europe."""
    if head[:2] in (codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE):
        return "utf-16"
    try:
        # the last character may be cut
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"

    return "utf-8-sig"


def streams_of(
    messages: Mapping[str, Sequence[tuple[int, Any]]], notes: tuple[str, ...] = ()
) -> tuple[Stream, ...]:
    """A stream for each topic whose messages are small enough to be columns.

    messages: (stamp in ns, message) of each topic.
    """
    streams = []
    for topic, sent in messages.items():
        stamps, values = zip(*sent, strict=True)
        # an image, or the like, is none
        with suppress(ColumnError):
            columns = fields_of(values, topic)
            t_ns = np.array(stamps, dtype=np.int64)
            streams.append(Stream(columns, t_ns, topic, notes))

    return tuple(streams)


def fields_of(messages: Sequence[Any], topic: str = "") -> Columns:
    """A column for each number or text of messages, also of nested ones. Raises ColumnError."""
    table = pd.DataFrame([flat_fields(message, topic) for message in messages])
    return {name: _typed(table[name].to_numpy(), name, ".", []) for name in table}


def _parsed(file: IO[str], layout: TableLayout, most: int) -> Columns:
    """The cells of each column as pandas reads them; most: rows.

    A long file read at once takes three times the memory of its table, and joined pieces twice: so
    each column gets its place first, which costs nothing while it is empty.
    """
    columns: Columns = {}
    rows = 0
    chunks = pd.read_csv(
        file,
        sep=r"\s+" if layout.form.separator == SPACES else layout.form.separator,
        decimal=layout.form.decimal,
        header=None,
        names=layout.names,
        index_col=False,
        chunksize=CHUNK_ROWS,
        skipinitialspace=True,
        keep_default_na=False,
        na_values=dict.fromkeys(layout.numeric, MISSING),
    )
    for chunk in chunks:
        for name, series in chunk.items():
            cells = series.to_numpy()
            column = columns.get(name, np.empty(most, cells.dtype))
            # whole numbers may go on as others, or as texts
            kind = np.result_type(column, cells)
            columns[name] = column = column.astype(kind, copy=False)
            column[rows : rows + len(cells)] = cells
        rows += len(chunk)

    return {name: column[:rows] for name, column in columns.items()}


def _numeric(cells: Columns, layout: TableLayout, notes: list[str]) -> Stream:
    """The columns as numbers or texts; rows without a number are left out, and noted.

    notes: on what was left out before.
    """
    columns: Columns = {}
    there = np.zeros(len(cells[layout.names[0]]), dtype=np.bool_)
    for name in layout.names:
        column = _typed(cells[name], name, layout.form.decimal, notes)
        if not is_text(column):
            there |= np.isfinite(column)
            if _are_thousands(column):
                raise ColumnError(
                    f"some numbers of {name} are whole, others as 2.987",
                    next_step="write numbers without signs between thousands, or all of them with "
                    "as many decimals",
                )
        elif name.startswith("column") and not any(column):
            # behind a separator at the end of every line
            continue
        columns[name] = column

    if not there.all():
        n_lost = count_of(int(np.sum(~there)), "line")
        notes.append(f"{n_lost} without a number left out")
        columns = {name: column[there] for name, column in columns.items()}
    return Stream(columns, notes=tuple(notes))


def _are_thousands(column: Column) -> bool:
    """Whether many numbers are whole, and all others as 2.987, none below 1 as a fraction is."""
    thousandths = (1000.0 * np.abs(column[::7])).round(6)
    thousandths = thousandths[thousandths > 0]
    is_whole = thousandths % 1000 == 0
    n_whole, others = np.sum(is_whole), thousandths[~is_whole]
    # but for 1 in 10 the last digit is there
    n_alike = np.sum(np.isin(others % 10, range(1, 10)) & (others < 1e6))
    are_both = 0.75 * len(others) < n_alike < 20 * n_whole
    return bool(are_both and n_whole > 9 and others.min() > 1000)


def _typed(column: Column, name: str, decimal: str, notes: list[str]) -> Column:
    """A column as numbers, as ns of its dates or times of day, or as texts."""
    if not is_text(column):
        return column if column.dtype.kind in "if" else column.astype(np.float64)
    cells = pd.Series(column).fillna("").astype(str).str.strip()
    filled = cells[~cells.isin(MISSING)]
    first = next(iter(filled), "")
    if STAMP.fullmatch(first):
        return _stamps(cells, first)
    texts = filled.str.removesuffix(" sec").str.replace(THOUSANDS, "", regex=True)
    numbers = pd.to_numeric(
        texts.str.replace(decimal, ".", regex=False), errors="coerce"
    )
    words = filled[numbers.isna()]
    if 2 * len(words) >= len(filled):
        return cells.to_numpy(object)
    # the names again, where a logger began anew, are no samples
    words = words[~words.isin([name, *name.split()])]
    for word, count in words.value_counts().head(3).items():
        notes.append(f"{name}: {count} cells {word!r:.20} are missing samples")
    found: Column = numbers.reindex(cells.index).to_numpy(np.float64)
    return found


def _stamps(cells: pd.Series, first: str) -> Column:
    """[T] dates, or times of day over midnight, as ns; nan where a cell is none.

    first: the first of them, which says how all are written.
    """
    # some write a comma or a colon before the fraction of a second
    texts = cells.str.replace(r",|(?<=:\d\d):(?=\d{3})", ".", regex=True)
    date = re.match(r"(\d{4}-)|\d+[./-]\w+[./-]\d", first)
    dates = pd.to_datetime(
        ("" if date else "1970-01-01 ") + texts.str.rstrip(" APM"),
        format="mixed" if date and not date[1] else "ISO8601",
        # where noon divides the day, a month stands before it
        dayfirst=not first.endswith("M"),
        utc=True,
        errors="coerce",
    )
    in_ns = dates.dt.as_unit("ns").to_numpy("M8[ns]")
    ns: Column = in_ns.astype(np.int64)
    if first.endswith("M"):
        # 12 PM is noon, and 12 AM midnight
        is_late = texts.str.endswith("PM").astype(int)
        ns += HALF_DAY_NS * (is_late - (dates.dt.hour == 12)).to_numpy()
    if dates.isna().any():
        ns = np.where(dates.isna(), np.nan, ns)
    # a step of nearly a day back is midnight
    is_midnight = np.diff(ns, prepend=ns[:1]) < -HALF_DAY_NS
    return ns + 2 * HALF_DAY_NS * np.cumsum(is_midnight)
