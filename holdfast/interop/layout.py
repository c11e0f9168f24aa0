"""How a table is laid out: its separator, its decimal sign, where its names stand.

Taken from the first lines. Names stand in the lines before the numbers that have as many cells; one
of them may hold units, and a merged heading stands for the cells to its right. Such a line may be a
comment, as numpy writes it. A table without names has `column1`, `column2`, ..

A line may begin with the time of its arrival (`14:02:11.000 -> 1,2,3`), or hold vectors in
brackets: `Form.cells` makes plain cells of it.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any

from holdfast.core.errors import ColumnError

SPACES = r"\s+"
SEPARATORS = ("\t", ";", "|", ",", SPACES)
COMMENTS = ("#", "%", "//", "!")
JUDGED_ROWS = 60
"""The last rows of the beginning of a file, which are data in any file with enough of them."""
MISSING = (
    "", "-", "--", "---", "?", "*", ".", "n/a", "N/A", "na", "NA", "#N/A", "#NA", "nan", "NaN",
    "NAN", "-nan", "null", "NULL", "None", "none", "#NUM!", "#VALUE!", "#DIV/0!", "inf", "-inf",
)  # fmt: skip
"""What stands in a column of numbers where a sample is missing."""
CLOCK = r"(?:\d{4}[-/.]\d\d?[-/.]\d\d?[T ])?\d{1,2}:\d\d:\d\d(?:[.,:]\d+)?"
ARRIVAL = re.compile(
    rf"^\s*\[?({CLOCK})\]?\s*(?:->|=>|>|\||:|-)?\s+(?=[-+\d.\[(A-Za-z])"
)
STAMP = re.compile(
    rf"{CLOCK}\s*(?:Z|[AP]M|[+-]\d\d:?\d\d)?|\d\d?[./]\d\d?[./]\d{{4}}[T ]{CLOCK}|\d\d?:\d\d[.,]\d+"
)
VECTOR = re.compile(r'"?[\[(]\s*([-+\d.][^\[\]()]*?)\s*[\])]"?')
UNITS = {
    "s", "ms", "us", "ns", "N", "mN", "kN", "g", "gf", "T", "mT", "uT", "G", "gauss", "count",
    "counts", "raw", "V", "mV", "-", "1", "µs", "µT", "μs", "μT", "sec", "1/s", "°C", "C",
}  # fmt: skip
"""What a row of units below the names holds."""
Cells = list[Any]


@dataclass(frozen=True)
class Form:
    """How lines become cells. is_odd: whether lines must be made plain before pandas reads them."""

    separator: str
    decimal: str
    is_odd: bool = False

    def cells(self, line: str) -> Cells:
        """The cells of a line."""
        mark = " " if self.separator == SPACES else self.separator
        line = ARRIVAL.sub(rf"\1{mark}", line)
        line = VECTOR.sub(lambda found: mark.join(re.split(r"[\s,;]+", found[1])), line)
        if self.separator == SPACES:
            return re.sub(r"(\d) (?=\d\d?:\d\d:)", r"\1T", line).split()
        try:
            cells = next(csv.reader([line.strip(" \r\n")], delimiter=mark), [])
        except csv.Error:
            return []

        return [cell.strip() for cell in cells]


@dataclass(frozen=True)
class TableLayout:
    """names: of the columns. first_row: index of the first line of numbers.

    numeric: the columns that hold numbers in the first lines. comment: what begins a comment.
    """

    form: Form
    names: tuple[str, ...]
    first_row: int
    numeric: tuple[str, ...]
    comment: str = ""


def layout_of(lines: Sequence[str]) -> TableLayout:
    """The layout of a text table by its first lines. Raises ColumnError for what is none.

    Each separator is tried with each decimal sign. The pair is taken that makes most cells of the
    last of these lines numbers, and of equal ones that with the most columns.
    """
    comment = next((one for one in COMMENTS if _begins(lines, one)), "")
    bare = [_uncommented(line, comment) for line in lines]
    data = [not (comment and line.lstrip().startswith(comment)) for line in lines]
    best, chosen = (0.0, 1), None
    for separator in SEPARATORS:
        for decimal in ".,":
            form = Form(separator, decimal)
            rows = [form.cells(line) for line in bare]
            body = [
                row for row, is_data in zip(rows, data, strict=True) if is_data and row
            ]
            body = body[-JUDGED_ROWS:]
            wide = usual_width(body)
            judged = [row for row in body if len(row) == wide]
            if wide < 2 or decimal == separator:
                continue
            share = _share_of_numbers(judged, decimal) * len(judged) / len(body)
            if share and (round(share, 3), wide) > best:
                best, chosen = (round(share, 3), wide), (form, rows)

    if chosen is None:
        raise ColumnError(
            "no table of several columns",
            cause="another kind of file, or a separator that is not a tab, a semicolon, a bar, "
            "a comma or spaces",
            next_step="save it as CSV",
        )

    form, rows = chosen
    first = first_of_data(rows, form.decimal, data)
    above = [_named_cells(line, bare[first], form) for line in bare[:first]]
    names, first = heading([*above, form.cells(bare[first])])
    form = replace(form, is_odd=_is_odd(bare[first:]))
    body = [row for row in rows[first:] if len(row) == len(names)]
    numeric = [
        name
        for k, name in enumerate(names)
        if _share_of_numbers([[row[k]] for row in body], form.decimal) >= 0.5
    ]
    is_later = _begins(lines[first:], comment)
    return TableLayout(form, names, first, tuple(numeric), comment if is_later else "")


def first_of_data(
    rows: Sequence[Cells], decimal: str, data: Sequence[bool] | None = None
) -> int:
    """Index of the first row of numbers. data: False for a comment line. Raises ColumnError."""
    wide = usual_width([row for row in rows if row][-JUDGED_ROWS:])
    for k, row in enumerate(rows):
        is_data = data is None or data[k]
        if (
            is_data
            and len(row) == wide
            and any(is_number(cell, decimal) for cell in row)
        ):
            return k

    raise ColumnError("no row of numbers", next_step="give a table with numbers")


def heading(rows: Sequence[Cells]) -> tuple[tuple[str, ...], int]:
    """(names of the columns, index of the first row of data) by the rows up to the first data.

    At most three rows above the data belong to the heading: groups, names, units.
    """
    first, wide = len(rows) - 1, len(rows[-1])
    if _counts_columns(rows[first]):
        return unique_names(rows[first]), first + 1
    above: list[list[str]] = []
    for row in reversed(rows[:first]):
        cells = _as_wide(row, rows[first])
        if cells is not None and len(above) < 3:
            above.append(cells)
        elif row:
            break

    if not above:
        return tuple(f"column{k}" for k in range(1, wide + 1)), first
    names = above.pop()
    for below in reversed(above):
        names = _under(names, below)
    return unique_names(names), first


def _as_wide(row: Cells, data: Cells) -> list[str] | None:
    """A row above the data as names, one a column; None where it is no heading."""
    cells = [str("" if cell is None else cell).strip() for cell in row]
    if len(cells) == len(data) + 1 and not cells[-1]:
        cells = cells[:-1]
    if len(cells) == len(data) - 1 and len(cells) > 1:
        # pandas and R write no name above row names; others end their rows by a separator
        cells = [*cells, ""] if data[-1] in ("", None) else ["", *cells]

    return cells if len(cells) == len(data) and any(cells) else None


def _under(above: list[str], below: list[str]) -> list[str]:
    """Names in two rows as one: units below names, or axes below a merged heading."""
    is_unit = all(cell.strip(" []()") in UNITS for cell in below if cell)
    names, last = [], ""
    for name, cell in zip(above, below, strict=True):
        # a merged heading stands in the first of its cells
        last = name if name or is_unit else last
        shown = f"[{cell.strip(' []()')}]" if is_unit and cell else cell
        names.append(" ".join(filter(None, [last, shown])))

    return names


def _named_cells(line: str, data: str, form: Form) -> Cells:
    """The cells of a heading, with a name for each number of a vector below: force.0, force.1."""
    cells = form.cells(line)
    counts = VECTOR.sub(
        lambda found: "\0" + str(len(re.split(r"[\s,;]+", found[1]))), data
    )
    below = form.cells(counts)
    if len(below) != len(cells):
        return cells
    wide: Cells = []
    for name, cell in zip(cells, below, strict=True):
        numbers = range(int(cell[1:])) if cell.startswith("\0") else ()
        wide += [f"{name}.{k}" for k in numbers] or [name]

    return wide


def unique_names(cells: Sequence[Any]) -> tuple[str, ...]:
    """Names for columns: an empty cell gets a number, a name that occurs again another."""
    names: dict[str, None] = {}
    for k, cell in enumerate(cells, 1):
        name = str("" if cell is None else cell).strip().strip('"') or f"column{k}"
        unique, again = name, 2
        while unique in names:
            unique, again = f"{name}.{again}", again + 1
        names[unique] = None

    return tuple(names)


def is_number(cell: Any, decimal: str) -> bool:
    """Whether a cell is a number, or a date or a time of day."""
    if isinstance(cell, bool) or cell is None:
        return False
    if isinstance(cell, int | float):
        return True
    text = str(cell).strip()
    if STAMP.fullmatch(text):
        return True
    try:
        float(text.replace(",", ".") if decimal == "," else text)
    except ValueError:
        return False

    return "_" not in text and text.lower().lstrip("+-") not in (
        "nan",
        "inf",
        "infinity",
    )


def usual_width(rows: Sequence[Cells]) -> int:
    """How many cells most rows have."""
    counts = Counter(len(row) for row in rows)
    return max(counts, key=lambda wide: (counts[wide], wide)) if counts else 0


def _begins(lines: Sequence[str], comment: str) -> bool:
    """Whether some line, but not most, begins with a sign of comments."""
    if not comment:
        return False
    n_begin = sum(line.lstrip().startswith(comment) for line in lines)
    return 0 < n_begin <= max(1, len(lines) // 2)


def _uncommented(line: str, comment: str) -> str:
    text = line.strip("\r\n")
    if comment and text.lstrip().startswith(comment):
        return text.lstrip().lstrip(comment).strip(" ")
    return text


def _share_of_numbers(rows: Sequence[Cells], decimal: str) -> float:
    """Of the cells that hold something."""
    filled = numbers = 0
    for row in rows:
        for cell in row:
            filled += cell not in MISSING
            numbers += is_number(cell, decimal)

    return numbers / filled if filled else 0.0


def _is_odd(lines: Sequence[str]) -> bool:
    """Whether lines are plain cells only after `Form.cells`."""
    return any(ARRIVAL.match(line) or VECTOR.search(line) for line in lines[:20])


def _counts_columns(cells: Cells) -> bool:
    """Whether a row is 0, 1, 2, .. as pandas names columns without names."""
    texts = [str(cell).strip() for cell in cells]
    # at the place of the index pandas writes nothing
    counted = texts[1:] if texts and not texts[0] else texts
    return len(counted) > 3 and counted == [str(k) for k in range(len(counted))]
