"""Text tables by pandas: any separator, decimal sign, encoding, comments, names anywhere on top.

Lines that pandas cannot read as they stand (a time of arrival in front, vectors in brackets, more
cells than names) are made plain first, and those that are left out are counted.
"""

from __future__ import annotations

import codecs
import csv
import io
import re
import warnings
from collections.abc import Iterable, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass
from itertools import islice
from pathlib import Path
from tempfile import TemporaryFile
from typing import IO, Any

import numpy as np

from holdfast.core.column_map import flat_fields
from holdfast.core.errors import (
    ColumnError,
    EmptyRecording,
    NotANumber,
    count_of,
    needs_extra,
)
from holdfast.interop.layout import (
    COMMENTS,
    MISSING,
    SPACES,
    STAMP,
    TableLayout,
    layout_of,
)
from holdfast.interop.streams import Column, Columns, ForeignLog, Stream, is_text

with needs_extra("train"):
    import pandas as pd

HEAD_BYTES, HEAD_LINES = 256 << 10, 240
"""Of the beginning, from which the layout is found."""
CHUNK_ROWS = 20_000
DAY_NS = 86_400 * 10**9
NOON = pd.Timedelta(hours=12)
EPOCH = pd.Timestamp(0, tz="UTC")


def begin_of(path: Path) -> tuple[TableLayout, str, bool]:
    """(layout, encoding, whether the last line is cut off) of a file. Raises a DataError."""
    with path.open("rb") as file:
        head = file.read(HEAD_BYTES)
        file.seek(-min(len(head), 4), io.SEEK_END)
        is_cut = not re.search(rb"[\r\n]\0*$", file.read())

    encoding = encoding_of(head)
    # a power cut leaves zeros at the end
    text = head.decode(encoding, errors="replace").rstrip("\0")
    if "\0" in text:
        raise NotANumber("a binary file", next_step="give a text table")
    lines = re.split(r"\r\n?|\n", text)
    if len(head) == HEAD_BYTES:
        # the last one may be cut
        lines.pop()
    return layout_of(lines[:HEAD_LINES]), encoding, is_cut


def read_log(path: Path, name: str) -> ForeignLog:
    """A file of text as a log of one table. Raises a DataError."""
    layout, encoding, is_cut = begin_of(path)
    about = {"rate_hz": layout.rate_hz, "unit": layout.unit}
    with path.open(encoding=encoding, errors="replace") as file:
        lines = _lines_of(file, layout)
        file.seek(0)
        if lines.is_plain and layout.comment != "//":
            # lines of more cells than the others need the slow way, too
            with suppress(pd.errors.ParserError, pd.errors.ParserWarning):
                cells = _parsed(file, layout, layout.first_row, lines.count)
                # a line that was cut off has no last cell
                n_torn = int(is_cut and str(cells[layout.names[-1]][-1]) in ("nan", ""))
                cells = {key: cell[: len(cell) - n_torn] for key, cell in cells.items()}
                stream = _numeric(cells, layout, n_torn, lines.notes)
                return ForeignLog(path, name, (stream,), about)
            file.seek(0)
        stream = read_table(islice(file, lines.stop), layout, lines.notes)
        return ForeignLog(path, name, (stream,), about)


@dataclass
class _Lines:
    """The lines of a table. stop: before which a second block ends the first; None for none.

    is_plain: whether pandas can read them all: it fills short ones up, and their cells would stand
    in other columns. count: from the first row on.
    """

    count: int = 0
    stop: int | None = None
    is_plain: bool = True
    notes: Sequence[str] = ()


def _lines_of(file: IO[str], layout: TableLayout) -> _Lines:
    """What stands between the rows of a table and behind them.

    A block ends with an empty line, where what follows is no row of it.
    """
    form, found = layout.form, _Lines()
    mark = None if form.separator == SPACES else form.separator
    others: list[str] = []
    most, n_short, was_empty, is_short = 0, 0, False, False
    for number, whole in enumerate(islice(file, layout.first_row, None), 1):
        found.count = number
        n_marks = len(whole.split()) if mark is None else whole.count(mark)
        most = most or n_marks
        if n_marks >= most and not was_empty and whole[0] in "0123456789-+.":
            is_short = False
            continue
        line = whole.strip(" \t\r\n\0")
        is_short = n_marks < most and bool(line)
        n_short += is_short
        if was_empty and line and (n_marks != most or not form.share(form.cells(line))):
            found.stop = layout.first_row + number - 1
            found.notes = [f"a second block that begins with {line!r:.40} left out"]
            break
        if line.startswith(COMMENTS) or (n_marks != most and line[:1].isalpha()):
            others.append(line[:40])
        was_empty = not line
    else:
        text = f"{count_of(len(others), 'line')} between the rows left out, such as "
        found.notes = [f"{text}{one!r}" for one in others[:1]]
    # the last line may be cut off
    is_odd = form.is_odd or others or found.stop
    found.is_plain = not is_odd and n_short <= is_short
    return found


def encoding_of(head: bytes) -> str:
    """UTF-16 by its mark or its zeros, else UTF-8, else that of Western Europe."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    if b"\0" in head[:2]:
        return "utf-16-be" if head.startswith(b"\0") else "utf-16-le"
    try:
        # the last character may be cut
        codecs.getincrementaldecoder("utf-8")().decode(head)
    except UnicodeDecodeError:
        return "cp1252"

    return "utf-8-sig"


def read_table(
    lines: Iterable[str], layout: TableLayout, notes: Sequence[str] = ()
) -> Stream:
    """A table whose lines are made plain one by one. Raises EmptyRecording.

    Lines of another number of cells are left out. The plain ones go through a file, because the
    cells of a long log as texts would fill the memory.
    """
    mark = " " if layout.form.separator == SPACES else layout.form.separator
    n_torn = 0
    with TemporaryFile("w+", encoding="utf-8", newline="") as file:
        plain = csv.writer(file, delimiter=mark)
        n_rows = 0
        for line in islice(lines, layout.first_row, None):
            if not line.strip() or (layout.comment and line.startswith(layout.comment)):
                continue
            cells = layout.form.cells(line)
            if len(cells) == len(layout.names):
                plain.writerow(cells)
                n_rows += 1
            else:
                n_torn += 1

        file.seek(0)
        return _numeric(_parsed(file, layout, 0, n_rows), layout, n_torn, notes)


def streams_of(
    messages: Mapping[str, Sequence[tuple[int, Any]]], notes: tuple[str, ...] = ()
) -> tuple[Stream, ...]:
    """A stream for each topic whose messages are small enough to be columns.

    messages: (stamp in ns, message) of each topic. Nested objects are flattened, a column for each
    number or text.
    """
    streams = []
    for topic, sent in messages.items():
        try:
            table = pd.DataFrame([flat_fields(message, topic) for _, message in sent])
        except ColumnError:
            continue  # an image, or the like
        columns = {
            name: _typed(table[name].to_numpy(), name, ".", []) for name in table
        }
        t_ns = np.array([stamp for stamp, _ in sent], dtype=np.int64)
        streams.append(Stream(columns, t_ns, topic, notes))

    return tuple(streams)


def _parsed(file: IO[str], layout: TableLayout, first_row: int, most: int) -> Columns:
    """The cells of each column as pandas reads them; most: rows.

    A long file read at once takes three times the memory of its table, and joined pieces twice: so
    each column gets its place first, which costs nothing while it is empty.
    """
    columns: Columns = {}
    rows = 0
    with warnings.catch_warnings():
        # rows of more cells than names: pandas warns, and would drop them
        warnings.simplefilter("error", pd.errors.ParserWarning)
        chunks = pd.read_csv(
            file,
            sep=layout.form.separator,
            decimal=layout.form.decimal,
            header=None,
            names=list(layout.names),
            index_col=False,
            skiprows=first_row,
            chunksize=CHUNK_ROWS,
            comment=layout.comment if len(layout.comment) == 1 else None,
            skipinitialspace=True,
            keep_default_na=False,
            na_values={name: list(MISSING) for name in layout.numeric},
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


def _numeric(
    cells: Columns, layout: TableLayout, n_torn: int, known: Sequence[str] = ()
) -> Stream:
    """The columns as numbers or texts; rows without a number are left out, and noted.

    n_torn: lines that are left out already. known: notes on others. Raises EmptyRecording.
    """
    columns: Columns = {}
    notes = [*known]
    if n_torn:
        notes.append(f"{count_of(n_torn, 'line')} of another number of cells left out")
    there = np.zeros(len(cells[layout.names[0]]), dtype=np.bool_)
    for name in layout.names:
        column = _typed(cells[name], name, layout.form.decimal, notes)
        if not is_text(column):
            there |= np.isfinite(column)
        elif name.startswith("column") and not any(column):
            # behind a separator at the end of every line
            continue
        columns[name] = column

    if not there.any():
        raise EmptyRecording("no row of data", next_step="record it again")
    if not there.all():
        n_lost = count_of(int(np.sum(~there)), "line")
        notes.append(f"{n_lost} without a number left out")
        columns = {name: column[there] for name, column in columns.items()}
    return Stream(columns, notes=tuple(notes))


def _typed(column: Column, name: str, decimal: str, notes: list[str]) -> Column:
    """A column as numbers, as ns of its dates or times of day, or as texts."""
    if not is_text(column):
        return column if column.dtype.kind in "if" else column.astype(np.float64)
    cells = pd.Series(column).fillna("").astype(str).str.strip()
    filled = cells[~cells.isin(MISSING)]
    if len(filled) and STAMP.fullmatch(filled.iloc[0]):
        return stamps_of(cells)
    texts = filled.str.replace(",", ".") if decimal == "," else filled
    numbers = pd.to_numeric(texts, errors="coerce")
    words = filled[numbers.isna()]
    if not len(filled) or 2 * len(words) > len(filled):
        return cells.to_numpy(object)
    # the names again, where a logger began anew, are no samples
    words = words[~words.isin([name, *name.split()])]
    for word, count in words.value_counts().head(3).items():
        notes.append(f"{name}: {count} cells {word!r:.20} are missing samples")
    found: Column = numbers.reindex(cells.index).to_numpy(np.float64)
    return np.where(np.isfinite(found), found, np.nan)


def stamps_of(cells: pd.Series) -> Column:
    """[T] dates, or times of day over midnight, as ns; nan where a cell is none."""
    first = next(cell for cell in cells if cell)
    # some write a comma or a colon before the fraction of a second
    texts = cells.str.replace(r",|(?<=:\d\d):(?=\d{3})", ".", regex=True)
    date = re.match(r"(\d{4}-)|\d+[./-]\d+[./-]\d", first)
    if date:
        form = "ISO8601" if date[1] and not first.endswith("M") else "mixed"
        dates = pd.to_datetime(
            texts, format=form, dayfirst=not date[1], utc=True, errors="coerce"
        )
        spans = dates - EPOCH
    else:
        clock = texts.str.extract(r"([\d:.]+)")[0]
        clock = clock.where(clock.str.count(":") > 1, "0:" + clock)
        spans = pd.to_timedelta(clock, errors="coerce")
        if first.endswith("M"):
            spans = spans % NOON + NOON * texts.str.endswith("PM").astype(int)

    ns: Column = spans.to_numpy("m8[ns]").astype(np.int64)
    if spans.isna().any():
        ns = np.where(spans.isna(), np.nan, ns)
    # a step of nearly a day back is midnight
    steps = np.nan_to_num(np.diff(ns, prepend=ns[:1]))
    return ns if date else ns + DAY_NS * np.cumsum(steps < -DAY_NS / 2)
