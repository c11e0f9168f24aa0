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
    rf"^\s*\[?({CLOCK})\]?\s*(?:->|=>|>|\||:|-)?\s+(?![AP]M\b)(?=[-+\d.\[(A-Za-z])"
)
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
STAMP = re.compile(
    rf"{CLOCK}\s*(?:Z|[AP]M|[+-]\d\d:?\d\d)?|\d\d?[./]\d\d?[./]\d{{4}}[T ]{CLOCK}|\d\d?:\d\d[.,]\d+"
)
VECTOR = re.compile(r'"?[\[(]\s*([-+\d.][^\[\]()]*?)\s*[\])]"?')
UNITS = {
    "s", "ms", "us", "ns", "N", "mN", "kN", "g", "gf", "T", "mT", "uT", "G", "gauss", "count",
    "counts", "raw", "V", "mV", "-", "1", "µs", "µT", "μs", "μT", "sec", "1/s", "°C", "C",
}  # fmt: skip
"""What a row of units below the names holds."""
GAP = r"[\s,;]+"
"""Between the numbers of a vector."""
MOST_HEADING_ROWS = 3
"""Groups, names and units."""
Cells = list[str]


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
        line = VECTOR.sub(lambda found: mark.join(re.split(GAP, found[1])), line)
        if self.separator == SPACES:
            return re.sub(r"(\d) (?=\d\d?:\d\d:)", r"\1T", line).split()
        try:
            cells = next(csv.reader([line.strip(" \r\n")], delimiter=mark), [])
        except csv.Error:
            return []

        return [cell.strip() for cell in cells]

    def share(self, cells: Sequence[str]) -> float:
        """How many of the cells that hold something are numbers, dates or times of day."""
        filled = [cell for cell in cells if cell not in MISSING]
        numbers = 0
        for cell in filled:
            plain = cell.replace(",", ".") if self.decimal == "," else cell
            numbers += bool(NUMBER.fullmatch(plain) or STAMP.fullmatch(plain))
        return numbers / len(filled) if filled else 0.0


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
    data = ["" if comment and _begins([line], comment) else line for line in lines]
    judged = list(filter(str.strip, data))[-JUDGED_ROWS:]
    forms = []
    for separator in SEPARATORS:
        # a comma may be both, where cells stand in quotes
        forms += [Form(separator, "."), Form(separator, ",")]
    form = max(forms, key=lambda one: _fit(one, judged))
    share, wide = _fit(form, judged)
    rows = [form.cells(line) for line in data]
    starts = [k for k, row in enumerate(rows) if len(row) == wide and form.share(row)]
    if not share or not starts:
        raise ColumnError(
            "no table of several columns",
            cause="another kind of file, or a separator that is not a tab, a semicolon, a bar, "
            "a comma or spaces",
            next_step="save it as CSV",
        )

    first = starts[0]
    is_odd = any(ARRIVAL.match(one) or VECTOR.search(one) for one in data[first:][:20])
    bare = [line.lstrip(f" {comment}") for line in lines[:first]]
    above = [_heading_cells(line, data[first], form) for line in bare]
    # pandas names columns without names 0, 1, 2, .., and writes nothing above the index
    counted = [*map(str, range(wide))]
    is_heading = wide > 3 and rows[first] in (counted, ["", *counted[:-1]])
    names = rows[first] if is_heading else _heading(above, rows[first])
    first += is_heading
    whole = [row for row in rows[first:] if len(row) == wide]
    names = _unique(names)
    numeric = []
    for name, *cells in zip(names, *whole, strict=True):
        if form.share(cells) >= 0.5:
            numeric.append(name)

    is_later = bool(comment) and _begins(lines[first:], comment)
    form = replace(form, is_odd=is_odd)
    return TableLayout(
        form, tuple(names), first, tuple(numeric), comment if is_later else ""
    )


def _begins(lines: Sequence[str], comment: str) -> bool:
    """Whether some lines begin with a sign of comments, but not most of several."""
    n_begin = sum(line.lstrip().startswith(comment) for line in lines)
    return 0 < n_begin <= max(1, len(lines) // 2)


def _fit(form: Form, lines: Sequence[str]) -> tuple[float, int]:
    """(the share of numbers in lines that a form reads, how many cells most of them have)."""
    rows = [form.cells(line) for line in lines]
    counts = Counter(map(len, rows))
    wide = max(counts, key=lambda cells: (counts[cells], cells), default=0)
    cells = [cell for row in rows for cell in row if len(row) == wide]
    share = form.share(cells) * counts[wide] / max(1, len(rows)) if wide > 1 else 0.0
    return round(share, 3), wide


# -- names


def _heading(above: Sequence[Cells], data: Cells) -> Cells:
    """A name for each cell of the first row of data, by the rows above it."""
    names: Cells = []
    n_rows = 0
    for row in reversed(above):
        cells = _as_wide(row, data)
        if any(cells) and n_rows < MOST_HEADING_ROWS:
            names, n_rows = _under(cells, names) if names else cells, n_rows + 1
        elif row:
            break

    return names or [""] * len(data)


def _as_wide(row: Cells, data: Cells) -> Cells:
    """A row above the data as names, one a column; [] where it is no heading."""
    missing = len(data) - len(row)
    if missing == -1 and not row[-1]:
        return row[:-1]
    if missing == 1 < len(row):
        # pandas and R write no name above row names; others end their rows by a separator
        return ["", *row] if data[-1] else [*row, ""]
    return row if not missing else []


def _under(above: Cells, below: Cells) -> Cells:
    """Names in two rows as one: units below names, or axes below a merged heading."""
    bare = [cell.strip(" []()") for cell in below]
    is_unit = {*bare} - {""} <= UNITS
    names, last = [], ""
    for name, cell, unit in zip(above, below, bare, strict=True):
        # a merged heading stands in the first of its cells
        last = name if name or is_unit else last
        shown = f"[{unit}]" if is_unit and unit else cell
        names.append(f"{last} {shown}".strip())

    return names


def _heading_cells(line: str, data: str, form: Form) -> Cells:
    """The cells of a heading, with a name for each number of a vector below: force.0, force.1."""
    cells = form.cells(line)
    # a vector of three is *3 here
    counts = VECTOR.sub(lambda found: f"*{len(re.split(GAP, found[1]))}", data)
    below = form.cells(counts)
    if len(below) != len(cells):
        return cells
    wide: Cells = []
    for name, cell in zip(cells, below, strict=True):
        numbers = range(int(cell[1:])) if cell.startswith("*") else ()
        wide += [f"{name}.{k}" for k in numbers] or [name]

    return wide


def _unique(cells: Cells) -> Cells:
    """Names for columns: an empty cell gets a number, a name that occurs again another."""
    names: Cells = []
    counts: Counter[str] = Counter()
    for k, cell in enumerate(cells, 1):
        name = cell.strip(' "') or f"column{k}"
        counts[name] += 1
        names.append(f"{name}.{counts[name]}" if counts[name] > 1 else name)

    return names
