"""Sheets of Excel workbooks by openpyxl, which only this module imports.

A sheet is read as the text that it would be, and is a stream. Of tables with an empty row between
them the first is read.
"""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from dataclasses import replace
from datetime import date, time
from pathlib import Path
from typing import Any

from holdfast.core.errors import DataError, needs_extra
from holdfast.interop.formats.layout import layout_of
from holdfast.interop.formats.streams import ForeignLog
from holdfast.interop.formats.tables import HEAD_LINES, pd, read_table

with needs_extra("xlsx"):
    import openpyxl


def read_log(path: Path, name: str) -> ForeignLog:
    """A workbook as a log: a stream for each sheet that is a table."""
    streams = []
    with warnings.catch_warnings():
        # of styles and the like, which no table needs
        warnings.simplefilter("ignore")
        book = openpyxl.load_workbook(path, read_only=True, data_only=True)
        for sheet in book.worksheets:
            cells = pd.DataFrame(sheet.values, dtype=object).map(_plain)
            text = cells.dropna(axis=1, how="all").to_csv(
                sep=";", header=False, index=False
            )
            # an empty row is an empty line
            lines = re.sub("(?m)^;+$", "", text).splitlines(keepends=True)
            # a sheet of notes is no table
            with suppress(DataError):
                table = read_table(lines, layout_of(tuple(lines[:HEAD_LINES])))
                streams.append(replace(table, name=sheet.title))

        book.close()

    return ForeignLog(path, name, tuple(streams))


def _plain(cell: Any) -> Any:
    """A date or a time of day as a text, a text on one line, an empty one as nothing."""
    if isinstance(cell, date | time):
        return cell.isoformat()
    return " ".join(cell.split()) or None if isinstance(cell, str) else cell
