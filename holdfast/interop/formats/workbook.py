"""Sheets of Excel workbooks by openpyxl, which only this module imports.

A sheet is read as the text that it would be, and is a stream. Of tables with an empty row between
them the first is read, and those with its names.
"""

from __future__ import annotations

import re
import warnings
from contextlib import suppress
from dataclasses import replace
from pathlib import Path

from holdfast.core.errors import DataError, needs_extra
from holdfast.interop.formats.layout import layout_of
from holdfast.interop.formats.streams import ForeignLog
from holdfast.interop.formats.tables import HEAD_LINES, pd, read_table

with needs_extra("xlsx"):
    import openpyxl  # noqa: F401 (pandas reads by it)


def read_log(path: Path, name: str) -> ForeignLog:
    """A workbook as a log: a stream for each sheet that is a table."""
    streams = []
    with warnings.catch_warnings():
        # of styles and the like, which no table needs
        warnings.simplefilter("ignore")
        sheets = pd.read_excel(
            path, sheet_name=None, header=None, dtype=object, na_filter=False
        )
    for title, cells in sheets.items():
        # a text may have several lines
        plain = cells.replace(r"\s+", " ", regex=True)
        text = plain.to_csv(sep=";", header=False, index=False)
        # an empty row is an empty line
        lines = re.sub("(?m)^[; ]+$", "", text).splitlines(keepends=True)
        # a sheet of notes is no table
        with suppress(DataError):
            table = read_table(lines, layout_of(tuple(lines[:HEAD_LINES])))
            streams.append(replace(table, name=title))

    return ForeignLog(path, name, tuple(streams))
