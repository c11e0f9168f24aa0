"""Sheets of Excel workbooks by openpyxl, which only this module imports.

A sheet may hold several tables: side by side with an empty column between them, or one below the
other with an empty row. Each is read as the text that it would be, and is a stream of its own.
"""

from __future__ import annotations

import warnings
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import replace
from datetime import date, time
from pathlib import Path
from typing import Any

from holdfast.core.errors import DataError, needs_extra
from holdfast.interop.layout import layout_of
from holdfast.interop.streams import ForeignLog
from holdfast.interop.tables import HEAD_LINES, pd, read_table

with needs_extra("xlsx"):
    import openpyxl


def read_log(path: Path, name: str) -> ForeignLog:
    """A workbook as a log: a stream for each table of its sheets."""
    streams = []
    with warnings.catch_warnings():
        # of styles and the like, which no table needs
        warnings.simplefilter("ignore")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        for sheet in book.worksheets:
            cells = pd.DataFrame(sheet.values, dtype=object).map(_plain)
            for number, block in enumerate(_blocks(cells)):
                lines = block.to_csv(sep=";", header=False, index=False).splitlines(
                    True
                )
                # a block of notes is no table
                with suppress(DataError):
                    table = read_table(lines, layout_of(lines[:HEAD_LINES]))
                    title = f"{sheet.title} ({number})" if number else sheet.title
                    streams.append(replace(table, name=title))

        book.close()

    return ForeignLog(path, name, tuple(streams))


def _blocks(cells: pd.DataFrame) -> Iterator[pd.DataFrame]:
    """Blocks between empty columns and empty rows; numbers without names belong to those above."""
    for columns in _parted(cells.T):
        block = pd.DataFrame()
        for rows in _parted(columns.T):
            if _has_number(block) and not _has_number(rows[:1]):
                yield block
                block = rows
            else:
                block = pd.concat([block, rows])
        yield block


def _parted(cells: pd.DataFrame) -> list[pd.DataFrame]:
    """The rows between empty ones."""
    is_empty = cells.isna().all(axis=1)
    numbers = is_empty.cumsum()[~is_empty]
    return [rows for _, rows in cells[~is_empty].groupby(numbers)]


def _has_number(cells: pd.DataFrame) -> bool:
    return bool(cells.apply(pd.to_numeric, errors="coerce").notna().any(axis=None))


def _plain(cell: Any) -> Any:
    """A date or a time of day as a text, a text on one line, an empty one as nothing."""
    if isinstance(cell, date | time):
        return cell.isoformat()
    return " ".join(cell.split()) or None if isinstance(cell, str) else cell
