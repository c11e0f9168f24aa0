"""Sheets of Excel workbooks by openpyxl, which only this module imports."""

from __future__ import annotations

import warnings
from pathlib import Path
from typing import Any

from holdfast.core.errors import (
    DataError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    needs_extra,
)
from holdfast.interop.logs.layout import TableFormat, names_of
from holdfast.interop.logs.log import Columns, column_of

with needs_extra("xlsx"):
    import openpyxl

MOST_ROWS = 1_048_576
"""Of a sheet; a workbook that says more is none of Excel's."""


def read_workbook(path: Path, form: TableFormat) -> tuple[Columns, int]:
    """(columns of a sheet, line of its first row). Raises a DataError that names the file."""
    rows = _rows(path, form.sheet)
    names, first = names_of(rows)
    wide = len(names)
    body = [row for row in rows[first:] if len(row) == wide]
    if not body:
        raise EmptyRecording("no row of data", where=path, next_step="fill the sheet")
    columns = {
        name: column_of([row[k] for row in body]) for k, name in enumerate(names)
    }
    return columns, first + 1


def _rows(path: Path, sheet: str | None) -> list[list[Any]]:
    """The cells of a sheet, all rows as wide as its names. Raises DataNotFound or NotANumber."""
    try:
        with warnings.catch_warnings():
            # of styles and the like, which no table needs
            warnings.simplefilter("ignore")
            book = openpyxl.load_workbook(path, read_only=True, data_only=True)
            try:
                names = book.sheetnames
                if sheet is not None and sheet not in names:
                    raise DataNotFound(
                        f"no sheet {sheet!r:.60}; it has {', '.join(names)}",
                        where=path,
                        next_step="correct sheet in the column map",
                    )
                chosen = book[sheet or names[0]]
                cells = chosen.iter_rows(max_row=MOST_ROWS, values_only=True)
                return _trimmed([list(row) for row in cells])
            finally:
                book.close()
    except DataError:
        raise
    except Exception as error:  # openpyxl raises whatever its parsing meets
        raise NotANumber(
            f"cannot be read as a workbook ({type(error).__name__})",
            where=path,
            cause="an old .xls, a file with a password, or an interrupted copy",
            next_step="save it as .xlsx or as CSV",
        ) from None


def _trimmed(rows: list[list[Any]]) -> list[list[Any]]:
    """Rows without the empty columns behind the last name; an empty row has no cell."""
    wide = 0
    for row in rows:
        filled = [k for k, cell in enumerate(row, 1) if cell not in (None, "")]
        wide = max(wide, filled[-1] if filled else 0)
    trimmed = []
    for row in rows:
        is_empty = all(cell in (None, "") for cell in row)
        trimmed.append([] if is_empty else (row + [None] * wide)[:wide])
    return trimmed
