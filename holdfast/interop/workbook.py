"""Sheets of Excel workbooks by openpyxl, which only this module imports.

A sheet may hold several tables: side by side with an empty column between them, or one below the
other with an empty row. Each is a stream of its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from datetime import date, time
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.errors import DataError, EmptyRecording, NotANumber, needs_extra
from holdfast.interop.layout import first_of_data, heading
from holdfast.interop.streams import Stream
from holdfast.interop.tables import cleaned, pd

with needs_extra("xlsx"):
    import openpyxl

SHEET = "sheet"
"""The column that names the sheet of a row, where several are one table."""
MOST_ROWS = 1_048_576
"""Of a sheet; a workbook that says more is none of Excel's."""
Rows = list[list[Any]]


def read_workbook(path: Path) -> list[Stream]:
    """All tables of all sheets. Raises a DataError that names the file."""
    streams = []
    for sheet, rows in _sheets(path).items():
        for number, block in enumerate(_blocks(rows), 1):
            name = sheet if number == 1 else f"{sheet} ({number})"
            streams += _stream(block, name)

    if not streams:
        raise EmptyRecording("no row of data", where=path, next_step="fill the sheet")
    return _joined(streams)


def _joined(streams: list[Stream]) -> list[Stream]:
    """Sheets of the same columns as one table, with the sheet of each row."""
    same: dict[tuple[str, ...], list[Stream]] = {}
    for stream in streams:
        same.setdefault(tuple(stream.columns), []).append(stream)
    tables = []
    for names, alike in same.items():
        table = alike[0]
        if len(alike) > 1:
            columns = {}
            for name in names:
                columns[name] = np.concatenate([one.columns[name] for one in alike])
            sheets = [one.name for one in alike for _ in range(one.rows)]
            table = Stream({**columns, SHEET: np.array(sheets, dtype=object)})
        tables.append(table)

    return tables


def _stream(rows: Rows, name: str) -> list[Stream]:
    """A block of cells as a table; none for a block without numbers."""
    try:
        first = first_of_data(rows, ".")
        names, first = heading(rows[: first + 1])
        cells = np.array(rows[first:], dtype=object)
        table = dict(zip(names, cells.T, strict=True))
        found = cleaned(table, ".", [])
    except DataError:
        return []

    return [Stream(found.columns, name=name, notes=found.notes)]


def _blocks(rows: Rows) -> Iterator[Rows]:
    """Blocks between empty columns and empty rows; numbers without names belong to those above."""
    cells = pd.DataFrame(rows, dtype=object)
    for first, stop in _runs(cells.notna().any(axis=0).tolist()):
        part = cells.iloc[:, first:stop]
        block: Rows = []
        for top, bottom in _runs(part.notna().any(axis=1).tolist()):
            below = part.iloc[top:bottom].to_numpy().tolist()
            if any(map(_has_number, block)) and not _has_number(below[0]):
                yield block
                block = []
            block += below
        yield block


def _has_number(row: list[Any]) -> bool:
    return any(isinstance(cell, int | float) for cell in row)


def _runs(flags: list[bool]) -> Iterator[tuple[int, int]]:
    """(first, stop) of each run of true."""
    start = None
    for k, flag in enumerate([*flags, False]):
        if flag and start is None:
            start = k
        elif not flag and start is not None:
            yield start, k
            start = None


def _sheets(path: Path) -> dict[str, Rows]:
    """The cells of all sheets. Raises NotANumber."""
    try:
        with warnings.catch_warnings():
            # of styles and the like, which no table needs
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                return {sheet.title: _cells(sheet) for sheet in book.worksheets}
            finally:
                book.close()
    except Exception as error:  # openpyxl raises whatever its parsing meets
        raise NotANumber(
            f"cannot be read as a workbook ({type(error).__name__})",
            where=path,
            cause="an old .xls, a file with a password, or an interrupted copy",
            next_step="save it as .xlsx or as CSV",
        ) from None


def _cells(sheet: Any) -> Rows:
    rows = sheet.iter_rows(max_row=MOST_ROWS, values_only=True)
    return [[_plain(cell) for cell in row] for row in rows]


def _plain(cell: Any) -> Any:
    """A date or a time of day as a text, an empty text as nothing."""
    if isinstance(cell, date | time):
        return cell.isoformat()
    return None if isinstance(cell, str) and not cell.strip() else cell
