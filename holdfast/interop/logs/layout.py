"""How a table is laid out: its separator, its decimal sign, where its names stand.

Taken from the first lines, for what the column map does not say. Names stand in the last line
before the numbers that has as many cells, or in the line above it where that one has units. Such a
line may be a comment, as numpy writes it. A table without names has `column1`, `column2`, ..
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from holdfast.core.errors import ColumnError

SPACES = r"\s+"
SEPARATORS = ("\t", ";", "|", ",", SPACES)
DECIMALS = (".", ",")
JUDGED_ROWS = 60
"""The last rows of the beginning of a file, which are data in any file with enough of them."""


@dataclass(frozen=True)
class TableFormat:
    """What the map's [table] says; None for what is found by itself."""

    separator: str | None = None
    decimal: str | None = None
    comment: str = "#"
    encoding: str | None = None
    sheet: str | None = None


@dataclass(frozen=True)
class TableLayout:
    """separator, decimal: of the cells. names: of the columns. first_row: index of its line."""

    separator: str
    decimal: str
    names: tuple[str, ...]
    first_row: int


Cells = list[Any]


def layout_of(lines: Sequence[str], form: TableFormat) -> TableLayout:
    """The layout of a text table by its first lines. Raises ColumnError for what is none."""
    best: tuple[float, int] = (-1.0, 0)
    chosen: tuple[str, str, list[Cells]] | None = None
    plain = [_uncommented(line, form.comment) for line in lines]
    data = [not line.lstrip().startswith(form.comment or "\0") for line in lines]
    for separator in (form.separator,) if form.separator else SEPARATORS:
        rows = _split(plain, separator)
        body = [row for row, is_data in zip(rows, data, strict=True) if is_data and row]
        wide = _usual_width(body[-JUDGED_ROWS:])
        if wide < 2:
            continue
        judged = [row for row in body[-JUDGED_ROWS:] if len(row) == wide]
        for decimal in (form.decimal,) if form.decimal else DECIMALS:
            if decimal == separator:
                continue
            share = _share_of_numbers(judged, decimal)
            score = (share * len(judged) / len(body[-JUDGED_ROWS:]), wide)
            if score > best:
                best, chosen = score, (separator, decimal, rows)
    if chosen is None:
        raise ColumnError(
            "no table of several columns",
            cause="another file, or a separator that is not a tab, a semicolon, a bar, "
            "a comma or spaces",
            next_step="name it in the column map: [table] separator = ..",
        )
    separator, decimal, rows = chosen
    names, first = names_of(rows, decimal, data)
    return TableLayout(separator, decimal, names, first)


def names_of(
    rows: Sequence[Cells], decimal: str = ".", data: Sequence[bool] | None = None
) -> tuple[tuple[str, ...], int]:
    """(names of the columns, index of the first row of data). data: False for a comment line.

    Raises ColumnError for rows without a number.
    """
    is_data = data or [True] * len(rows)
    body = [row for row, true in zip(rows, is_data, strict=True) if true and row]
    wide = _usual_width(body[-JUDGED_ROWS:])
    first = None
    for k, row in enumerate(rows):
        if is_data[k] and len(row) == wide and any(_is_number(c, decimal) for c in row):
            first = k
            break
    if first is None:
        raise ColumnError("no row of numbers", next_step="give a table with numbers")
    if _counts_columns(rows[first]):
        return unique_names(rows[first]), first + 1

    above: list[Cells] = []
    for row in reversed(rows[:first]):
        if not row:
            continue
        if len(row) != wide or len(above) == 2:
            break
        above.append(row)
    if not above:
        return tuple(f"column{k}" for k in range(1, wide + 1)), first
    names = [str(cell or "").strip() for cell in above[-1]]
    if len(above) == 2:
        units = [str(cell or "").strip(" []()") for cell in above[0]]
        names = [f"{a} [{b}]" if b else a for a, b in zip(names, units, strict=True)]
    return unique_names(names), first


def unique_names(cells: Sequence[Any]) -> tuple[str, ...]:
    """Names for columns: an empty cell gets a number, a name that occurs again another."""
    names: list[str] = []
    for k, cell in enumerate(cells, 1):
        name = str("" if cell is None else cell).strip().strip('"') or f"column{k}"
        unique, again = name, 2
        while unique in names:
            unique, again = f"{name}.{again}", again + 1
        names.append(unique)
    return tuple(names)


def _uncommented(line: str, comment: str) -> str:
    text = line.strip("\r\n")
    if comment and text.lstrip().startswith(comment):
        return text.lstrip()[len(comment) :].strip()
    # a comment behind the cells of a row
    return text.partition(comment)[0] if comment else text


def _split(lines: Sequence[str], separator: str) -> list[Cells]:
    if separator == SPACES:
        return [line.split() for line in lines]
    rows: list[Cells] = []
    for line in lines:
        try:
            rows.extend(csv.reader([line], delimiter=separator) if line else [[]])
        except csv.Error:
            rows.append([])
    # a quote that is not closed may swallow a line
    return (rows + [[]] * len(lines))[: len(lines)]


def _usual_width(rows: Sequence[Cells]) -> int:
    """How many cells most rows have."""
    counts = Counter(len(row) for row in rows)
    return max(counts, key=lambda wide: (counts[wide], wide)) if counts else 0


def _share_of_numbers(rows: Sequence[Cells], decimal: str) -> float:
    cells = [cell for row in rows for cell in row if str(cell).strip()]
    numbers = sum(_is_number(cell, decimal) for cell in cells)
    return numbers / len(cells) if cells else 0.0


def _is_number(cell: Any, decimal: str) -> bool:
    if isinstance(cell, bool) or cell is None:
        return False
    if isinstance(cell, int | float):
        return True
    text = str(cell).strip()
    if decimal == ",":
        # a point may still be there, between thousands
        text = re.sub(r"(?<=[0-9])\.(?=[0-9]{3})", "", text).replace(",", ".", 1)
    try:
        float(text)
    except ValueError:
        return False
    return "_" not in text


def _counts_columns(cells: Cells) -> bool:
    """Whether a row is 0, 1, 2, .. as pandas names columns without names."""
    texts = [str(cell).strip() for cell in cells]
    # at the place of the index pandas writes nothing
    counted = texts[1:] if texts and not texts[0] else texts
    return len(counted) > 3 and counted == [str(k) for k in range(len(counted))]
