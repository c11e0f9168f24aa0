"""Text tables by pandas: any separator, decimal comma, BOM, comments, names anywhere on top."""

from __future__ import annotations

import codecs
import re
import warnings
from pathlib import Path

import numpy as np

from holdfast.core.errors import (
    ColumnError,
    DataError,
    EmptyRecording,
    NotANumber,
    needs_extra,
)
from holdfast.interop.logs.layout import TableFormat, TableLayout, layout_of
from holdfast.interop.logs.log import Columns

with needs_extra("train"):
    import pandas as pd

HEAD_BYTES, HEAD_LINES = 256 << 10, 400
"""Of the beginning, from which the layout is found."""
BOMS = ((codecs.BOM_UTF16_LE, "utf-16"), (codecs.BOM_UTF16_BE, "utf-16"))
DATE = re.compile(r"\d{4}-\d\d-\d\d[T ]\d\d:\d\d")
UTF8, WESTERN = "utf-8-sig", "cp1252"


def read_text_table(path: Path, form: TableFormat) -> tuple[Columns, int]:
    """(columns, line of the first row). Raises a DataError that names the file."""
    try:
        with path.open("rb") as file:
            head = file.read(HEAD_BYTES)
        encoding = form.encoding or _encoding(head)
        layout = layout_of(_lines(head, encoding), form)
        return _read(path, layout, form, encoding), layout.first_row + 1
    except DataError as error:
        raise _at(error, path) from None
    except (OSError, LookupError, UnicodeError) as error:
        raise NotANumber(
            f"cannot be read as text ({type(error).__name__})",
            where=path,
            cause="a binary file, or another encoding",
            next_step="name it in the column map: [table] encoding = ..",
        ) from None


def _at(error: DataError, path: Path) -> DataError:
    """The same error with the file where it has none."""
    return type(error)(
        error.what,
        where=error.where or path,
        cause=error.cause,
        next_step=error.next_step,
    )


def _encoding(head: bytes) -> str:
    for bom, name in BOMS:
        if head.startswith(bom):
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


def _read(path: Path, layout: TableLayout, form: TableFormat, encoding: str) -> Columns:
    """All columns. Raises ColumnError, NotANumber or EmptyRecording."""
    try:
        with warnings.catch_warnings():
            # rows of more cells than names: pandas warns, and would drop them
            warnings.simplefilter("error", pd.errors.ParserWarning)
            table = pd.read_csv(
                path,
                sep=layout.separator,
                decimal=layout.decimal,
                header=None,
                names=list(layout.names),
                index_col=False,
                skiprows=layout.first_row,
                comment=form.comment or None,
                encoding=encoding,
                low_memory=False,
                skipinitialspace=True,
            )
    except UnicodeDecodeError:
        # bytes that are not UTF-8 may come late in the file
        if encoding == WESTERN or form.encoding:
            raise
        return _read(path, layout, form, WESTERN)
    except (pd.errors.ParserError, pd.errors.ParserWarning, ValueError) as error:
        raise ColumnError(
            f"not a table of {len(layout.names)} columns "
            f"({' '.join(str(error).split())[:160]})",
            where=path,
            cause="a row with another number of cells, or another separator",
            next_step="correct that row, or [table] of the column map",
        ) from None
    if not len(table):
        raise EmptyRecording("no row of data", where=path, next_step="record it again")
    columns: Columns = {}
    for name in layout.names:
        column = table[name]
        if name.startswith("column") and column.isna().all():
            continue  # behind a separator at the end of every line
        if column.dtype.kind in "iufb":
            columns[name] = column.to_numpy()
        else:
            texts = column.astype(object).where(column.notna(), "").to_numpy()
            columns[name] = _as_stamps(texts)
    return {name: _plain(column) for name, column in columns.items()}


def _as_stamps(texts: np.ndarray) -> np.ndarray:
    """Dates with a time of day as ns since 1970; other texts as they are."""
    if not len(texts) or not DATE.match(str(texts[0])):
        return texts
    try:
        stamps = pd.to_datetime(pd.Series(texts), format="ISO8601", utc=True)
    except (ValueError, OverflowError):
        return texts
    ns: np.ndarray = stamps.to_numpy(dtype="datetime64[ns]").astype(np.int64)
    return ns


def _plain(column: np.ndarray) -> np.ndarray:
    """uint64 beyond int64 as floats; texts as str."""
    if column.dtype.kind == "u":
        return column.astype(np.float64)
    if column.dtype == object:
        return np.array([str(cell) for cell in column], dtype=object)
    return column
