"""Text tables by pandas: any separator, decimal sign, encoding, comments, names anywhere on top.

Lines that pandas cannot read as they stand (a time of arrival in front, vectors in brackets, more
cells than names) are made plain first, and those that are left out are counted.
"""

from __future__ import annotations

import codecs
import io
import re
import warnings
from collections import Counter
from pathlib import Path

import numpy as np

from holdfast.core.errors import (
    DataError,
    EmptyRecording,
    NotANumber,
    needs_extra,
)
from holdfast.interop.layout import (
    MISSING,
    SPACES,
    STAMP,
    TableLayout,
    is_number,
    layout_of,
)
from holdfast.interop.streams import Column, Columns, Stream, is_text, text_column

with needs_extra("train"):
    import pandas as pd

HEAD_BYTES, HEAD_LINES = 256 << 10, 240
"""Of the beginning, from which the layout is found."""
FEWEST_ROWS = 3
CHUNK_ROWS = 100_000
UTF8, WESTERN = "utf-8-sig", "cp1252"
DAY_NS, SECOND_NS = 86_400 * 10**9, 10**9
NO_STAMP = np.iinfo(np.int64).min
"""What pandas has for a time that is missing."""


def read_text_table(path: Path) -> Stream:
    """A table. Raises a DataError that names the file."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        encoding = encoding_of(head)
        layout = layout_of(_lines(head, encoding))
        return _read(path, layout, encoding)
    except DataError as error:
        raise type(error)(
            error.what,
            where=error.where or path,
            cause=error.cause,
            next_step=error.next_step,
        ) from None
    except (OSError, UnicodeError) as error:
        raise NotANumber(
            f"cannot be read as text ({type(error).__name__})",
            where=path,
            cause="a binary file, or another encoding",
            next_step="save it as CSV in UTF-8",
        ) from None


def is_table(path: Path) -> bool:
    """Whether a file is a table of numbers, and no prose."""
    try:
        columns = list(read_text_table(path).columns.values())
    except DataError:
        return False

    n_numbers = sum(not is_text(column) for column in columns)
    return len(columns[0]) >= FEWEST_ROWS and 2 * n_numbers >= len(columns)


def encoding_of(head: bytes) -> str:
    """By its mark, by the zeros of UTF-16, else UTF-8, else that of Western Europe."""
    if head.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE)):
        return "utf-16"
    for name, first in (("utf-16-le", 1), ("utf-16-be", 0)):
        zeros = head[first::2].count(0)
        if zeros > len(head) // 4 and not head[1 - first :: 2].count(0):
            return name

    try:
        # the last character may be cut
        codecs.getincrementaldecoder(UTF8)().decode(head)
    except UnicodeDecodeError:
        return WESTERN

    return UTF8


def _lines(head: bytes, encoding: str) -> list[str]:
    """The first lines, without the last one, which may be cut."""
    text = codecs.getincrementaldecoder(encoding)(errors="replace").decode(head)
    if "\0" in text:
        raise NotANumber("a binary file", next_step="give a text table")
    lines = text.replace("\r\n", "\n").replace("\r", "\n").split("\n")
    if len(head) == HEAD_BYTES:
        lines = lines[:-1]
    return lines[:HEAD_LINES]


def _read(path: Path, layout: TableLayout, encoding: str) -> Stream:
    """All columns. Raises ColumnError or EmptyRecording."""
    notes: list[str] = []
    source: Path | io.StringIO = path
    skipped = layout.first_row
    if layout.form.is_odd or layout.comment == "//":
        source, skipped = _plain(path, layout, encoding, notes), 0
    try:
        table = _parsed(source, layout, encoding, skipped)
    except UnicodeDecodeError:
        # bytes that are not UTF-8 may come late in the file
        if encoding == WESTERN:
            raise
        return _read(path, layout, WESTERN)
    except (pd.errors.ParserError, pd.errors.ParserWarning):
        # lines with more cells than the others
        whole = _plain(path, layout, encoding, notes)
        table = _parsed(whole, layout, encoding, 0)

    return cleaned(table, layout.form.decimal, notes, is_cut=_is_cut(path, layout))


def _parsed(
    source: Path | io.StringIO,
    layout: TableLayout,
    encoding: str,
    skipped: int,
) -> Columns:
    parts: dict[str, list[Column]] = {name: [] for name in layout.names}
    with warnings.catch_warnings():
        # rows of more cells than names: pandas warns, and would drop them
        warnings.simplefilter("error", pd.errors.ParserWarning)
        # in chunks: a long file read at once takes three times the memory of its table
        chunks = pd.read_csv(
            source,
            sep=layout.form.separator,
            decimal=layout.form.decimal,
            header=None,
            names=list(layout.names),
            index_col=False,
            skiprows=skipped,
            chunksize=CHUNK_ROWS,
            comment=layout.comment if len(layout.comment) == 1 else None,
            encoding=encoding,
            skipinitialspace=True,
            keep_default_na=False,
            na_values={name: list(MISSING) for name in layout.numeric},
        )
        for chunk in chunks:
            for name, column in parts.items():
                column.append(chunk[name].to_numpy(copy=True))

    columns = {}
    for name in layout.names:
        columns[name] = np.concatenate(parts.pop(name))
    return columns


def _plain(
    path: Path, layout: TableLayout, encoding: str, notes: list[str]
) -> io.StringIO:
    """The lines of data with plain cells; those of another number of cells are left out."""
    text = path.read_text(encoding, errors="replace")
    mark = " " if layout.form.separator == SPACES else layout.form.separator
    kept: list[str] = []
    n_torn = 0
    for line in text.splitlines()[layout.first_row :]:
        is_comment = bool(layout.comment) and line.startswith(layout.comment)
        cells = layout.form.cells(line)
        is_whole = len(cells) == len(layout.names)
        if is_whole and not is_comment:
            kept.append(mark.join(f'"{cell}"' for cell in cells))
        elif line.strip() and not is_comment:
            n_torn += 1

    if n_torn:
        notes.append(f"{n_torn} lines of another number of cells left out")
    return io.StringIO("\n".join(kept))


def _is_cut(path: Path, layout: TableLayout) -> bool:
    """Whether the last line ends before its last cell: a number there may be cut too."""
    with path.open("rb") as file:
        file.seek(max(0, path.stat().st_size - (64 << 10)))
        tail = file.read()

    if tail.endswith((b"\n", b"\r", b"\n\0")):
        return False
    last = re.split(rb"[\r\n]", tail)[-1].decode("latin-1")
    return len(layout.form.cells(last)) < len(layout.names)


def cleaned(
    table: Columns, decimal: str, notes: list[str], *, is_cut: bool = False
) -> Stream:
    """The columns as numbers or texts; rows without a number are left out, and noted.

    Raises EmptyRecording.
    """
    columns: Columns = {}
    for name in list(table):
        column = _typed(table.pop(name), decimal, name, notes)
        is_empty = not any(column) if is_text(column) else np.isnan(column).all()
        # behind a separator at the end of every line
        if not (name.startswith("column") and is_empty):
            columns[name] = column

    there = np.zeros(len(column), dtype=np.bool_)
    for column in columns.values():
        if not is_text(column):
            there |= np.isfinite(column)

    if is_cut:
        there[-1:] = False
    n_lost = int(np.count_nonzero(~there))
    if not there.any():
        raise EmptyRecording("no row of data", next_step="record it again")
    if n_lost:
        columns = {name: column[there] for name, column in columns.items()}
        notes.append(f"{n_lost} lines without a number, or cut off, left out")

    return Stream(columns, notes=tuple(notes))


def _typed(column: Column, decimal: str, name: str, notes: list[str]) -> Column:
    """A column as numbers, as ns of its dates or times of day, or as texts."""
    if column.dtype.kind in "iufb":
        return column.astype(np.float64) if column.dtype.kind in "ub" else column
    there = pd.notna(column)
    cells = text_column(np.where(there, column, "").tolist())
    filled = cells[cells != ""]
    if len(filled) and STAMP.fullmatch(filled[0]):
        return stamps_of(cells)
    words = [cell for cell in filled.tolist() if not is_number(cell, decimal)]
    numbers = len(filled) - len(words)
    if not len(filled) or numbers < max(1, len(filled) // 2):
        return cells
    texts = pd.Series(cells)
    if decimal == ",":
        texts = texts.str.replace(",", ".", regex=False)
    for word, count in Counter(words).most_common(3):
        notes.append(f"{name}: {count} cells {word!r:.20} are missing samples")
    found: Column = pd.to_numeric(texts, errors="coerce").to_numpy(np.float64)
    return np.where(np.isfinite(found), found, np.nan)


def stamps_of(cells: Column) -> Column:
    """[T] dates, or times of day over midnight, as ns; nan where a cell is none."""
    first = next(cell for cell in cells if cell)
    if not re.match(r"\d+[./-]\d+[./-]\d+", first):
        return _times_of_day(cells)
    form = "ISO8601" if re.match(r"\d{4}-", first) else "mixed"
    texts = pd.Series(cells).str.replace(",", ".", regex=False)
    dates = pd.to_datetime(
        texts, format=form, dayfirst=form == "mixed", utc=True, errors="coerce"
    )
    ns: Column = dates.to_numpy(dtype="datetime64[ns]").astype(np.int64)
    return np.where(ns == NO_STAMP, np.nan, ns) if (ns == NO_STAMP).any() else ns


def _times_of_day(cells: Column) -> Column:
    parts = pd.Series(cells).str.extract(r"(?:(\d+):)?(\d+):(\d\d)(?:[.,:](\d+))?")
    hours, minutes, seconds = (pd.to_numeric(parts[k]).fillna(0.0) for k in range(3))
    fraction_ns = pd.to_numeric(parts[3].fillna("0").str.ljust(9, "0").str[:9])
    whole_s = (hours * 60.0 + minutes) * 60.0 + seconds
    ns: Column = np.array(whole_s * SECOND_NS + fraction_ns, dtype=np.float64)
    ns[parts[2].isna().to_numpy()] = np.nan
    # a step of nearly a day back is midnight
    steps = np.nan_to_num(np.diff(ns, prepend=ns[:1]))
    return ns + DAY_NS * np.cumsum(steps < -DAY_NS / 2)
