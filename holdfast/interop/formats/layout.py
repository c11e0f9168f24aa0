"""How a table is laid out: its separator, its decimal sign, where its names stand.

Taken from the first lines. Names stand in the lines before the numbers that have as many cells; one
of them may hold units, and a merged heading stands for the cells to its right. Such a line may be a
comment, as numpy writes it. A table without names has `column1`, `column2`, ..

A line may begin with the time of its arrival (`14:02:11.000 -> 1,2,3`), hold vectors in brackets,
or name each of its numbers (`x:1 y:2`): `Form.cells` makes plain cells of it.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import lru_cache

from holdfast.core.column_map import MINUS
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
    rf"^\s*(?:\[?({CLOCK})\]?\s*(?:->|=>|>|\||:|-)?\s+(?![AP]M\b)(?=[-+\d.\[(A-Za-z])"
    r"|[EWIDV] \((\d+)\) [\w.-]+: *)"
)
"""A time before a line, of day or, of ESP-IDF, in ms."""
NUMBER = re.compile(r"[-+]?(\d+\.?\d*|\.\d+)(e[-+]?\d+)?", re.IGNORECASE)
STAMP = re.compile(
    rf"{CLOCK}\s*(?:Z|[AP]M|[+-]\d\d:?\d\d)?|\d\d?[./]\d\d?[./]\d{{4}}[T ]{CLOCK}"
)
_CELL = r"(?:[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?|nan|none|null)"
GAP = r"[\s,;]+"
"""Between the numbers of a vector."""
VECTOR = re.compile(rf'(?i)"?[\[(]\s*({_CELL}(?:{GAP}{_CELL})*)[\s,;]*[\])]"?')
"""Numbers in brackets, and nothing else: a unit such as (0.01 N) is none."""
LONG_MINUS = "\N{MINUS SIGN}"
"""Of programs that write for people; a number begins with the short one."""
PAIR = re.compile(r"(?<![^\s,;|])([^\W\d][\w.\[\]]*)\s*[:=]\s*(?=\S)")
FEWEST_PAIRS = 3
"""A name before a cell, as for the plotter of a serial monitor; more than so many in a line."""
NUMBER_HZ = r"(?<![\d.,])(\d+(?:\.\d+)?)"
RATE = re.compile(
    r"(?im)(?:^\W*rate|\bfs|\b(?:sampl\w*|acqui\w*|scan|abtast)[-_ ]*(?:rate|freq\w*?))(?![a-z])"
    rf"(?:.*?(?={NUMBER_HZ}[\s,;]*hz)|[^\dk\n]*(?={NUMBER_HZ}\W*$))"
    rf"|^\W*(?:devices|trajectories|model outputs)\W*\n(?={NUMBER_HZ}\W*$)"
)
"""What a line above the names says of the rate, in Hz; of Vicon, the line below a block's name."""
PERIOD = re.compile(r"(?im)^delta_x\s+(\d*[.,]?\d+(?:e-?\d+)?)")
"""What LabVIEW says of the time between two rows, in s."""
HEAD_UNIT = re.compile(
    r"(?im)(?:(?<![a-z])units?(?:[ _]label)?[ \t]*[:=,;\t][\W_]*|\bin\s+|^[#%!/].*?[\[(])"
    r"([^\W\d_]+)"
)
"""Words of units in the lines above the names; also those of other quantities."""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([,.' ]\d{3})+")
"""A whole number with a sign between its thousands; its fraction may follow."""
MOST_HEADING_ROWS = 3
"""Groups, names and units."""
Cells = list[str]


@dataclass(frozen=True)
class Form:
    """How lines become cells. is_odd: whether lines must be made plain before pandas reads them.

    has_names: whether each cell of a line has its name before it. thousands: the sign between them.
    """

    separator: str
    decimal: str
    has_names: bool = False
    is_odd: bool = False
    thousands: str = ""

    @property
    def mark(self) -> str:
        """What stands between the cells of a plain line."""
        return " " if self.separator == SPACES else self.separator

    def cells(self, line: str) -> Cells:
        """The cells of a line."""
        mark = self.mark
        line = line.replace(LONG_MINUS, MINUS)
        line = ARRIVAL.sub(rf"\1\2{mark}", line)
        line = VECTOR.sub(lambda found: mark.join(re.split(GAP, found[1])), line)
        line = PAIR.sub("", line) if self.has_names else line
        if self.separator == SPACES:
            return re.sub(r"(\d) (?=\d\d?:\d\d:)", r"\1T", line).split()
        try:
            cells = next(csv.reader([line.strip(" \r\n")], delimiter=mark), [])
        except csv.Error:
            return []

        cells = [cell.strip() for cell in cells]
        if self.thousands:
            whole = [cell.partition(self.decimal)[0] for cell in cells]
            for k, found in enumerate(map(GROUPED.fullmatch, whole)):
                cells[k] = cells[k].replace(self.thousands, "") if found else cells[k]
        return cells

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

    numeric: the columns that hold numbers in the first lines. rate_hz: as the lines above the names
    say, None where they say nothing. unit: words of theirs.
    """

    form: Form
    names: tuple[str, ...]
    first_row: int
    numeric: tuple[str, ...]
    rate_hz: float | None = None
    unit: str = ""


@lru_cache(maxsize=32)
def layout_of(lines: tuple[str, ...]) -> TableLayout:
    """The layout of a text table by its first lines. Raises ColumnError for what is none.

    Each separator is tried with each decimal sign. The pair is taken that makes most cells of the
    last of these lines numbers, and of equal ones that with the most columns. Kept for the newest
    tables: an import looks at each several times.
    """
    data = ["" if line.lstrip().startswith(COMMENTS) else line for line in lines]
    judged = list(filter(str.strip, data))[-JUDGED_ROWS:]
    # the last line may be cut off
    has_names = len(PAIR.findall(" ".join(judged[-2:-1]))) > FEWEST_PAIRS
    forms = []
    for separator in SEPARATORS:
        # a comma may be both, where cells stand in quotes
        forms += [Form(separator, sign, has_names) for sign in (".", ",")]
        for sign, mark in ((".", ","), (".", "'"), (",", ".")):
            forms.append(Form(separator, sign, has_names, thousands=mark))
    form = max(forms, key=lambda one: _fit(one, judged))
    share, wide = _fit(form, judged)
    rows = [form.cells(line) for line in data]
    # a heading may begin with a time of arrival
    are_data = [len(row) == wide and form.share(row) > 0.5 * share for row in rows]
    if not share or True not in are_data:
        raise ColumnError(
            "no table of several columns",
            cause="another kind of file, or a separator that is not a tab, a semicolon, a bar, "
            "a comma or spaces",
            next_step="save it as CSV",
        )

    first = are_data.index(True)
    odd = (
        ARRIVAL.match(one) or VECTOR.search(one) or LONG_MINUS in one
        for one in data[first:]
    )
    is_odd = form.has_names or bool(form.thousands) or any(odd)
    above = [line.lstrip(f" {''.join(COMMENTS)}") for line in lines[:first]]
    names = _heading(above, data[first], form)
    if form.has_names:
        found = PAIR.findall(data[first])[:wide]
        # the time of arrival has none
        names = [""] * (wide - len(found)) + found
    names = _unique(names)
    whole = [row for row in rows[first:] if len(row) == wide]
    columns = zip(names, *whole, strict=True)
    numeric = [name for name, *cells in columns if form.share(cells) >= 0.5]
    form = replace(form, is_odd=is_odd)
    head = "\n".join(lines[:first])
    rates = {*map(max, RATE.findall(head))}
    for period in PERIOD.findall(head):
        period_s = float(period.replace(",", "."))
        rates |= {1.0 / period_s} if period_s else set()
    rate_hz = float(rates.pop()) if len(rates) == 1 else None
    return TableLayout(
        form,
        tuple(names),
        first,
        tuple(numeric),
        rate_hz,
        " ".join(HEAD_UNIT.findall(head)),
    )


def _fit(form: Form, lines: Sequence[str]) -> tuple[float, int]:
    """(the share of numbers in lines that a form reads, how many cells most of them have)."""
    rows = [form.cells(line) for line in lines]
    counts = Counter(map(len, rows))
    wide = max(counts, key=lambda cells: (counts[cells], cells), default=0)
    cells = [cell for row in rows for cell in row if len(row) == wide]
    share = form.share(cells) * counts[wide] / max(1, len(rows)) if wide > 1 else 0.0
    marked = [cell for cell in cells if "," in cell]
    if form.decimal == "," and 0 < len(marked) < 0.9 * len(cells):
        # a comma that stands only in numbers from 1000 on, before three digits, is no decimal sign
        share *= 0.9 if all(map(GROUPED.fullmatch, marked)) else 1.0
    return round(share, 3), wide


# -- names


def _heading(above: Sequence[str], data: str, form: Form) -> Cells:
    """A name for each cell of the first line of data, by the lines above it.

    The numbers of a vector are force.0, force.1, ..
    """
    cells = form.cells(data)
    sizes = [len(re.split(GAP, found[1])) for found in VECTOR.finditer(data)]
    below = form.cells(VECTOR.sub("[]", data))
    widths = [sizes.pop(0) if cell == "[]" else 1 for cell in below]
    names = [""] * len(cells)
    n_rows = 0
    for line in reversed(above):
        row = _as_wide(form.cells(line), cells, widths)
        if any(row) and n_rows < MOST_HEADING_ROWS:
            last = ""
            for k, name in enumerate(row):
                # above other names, a merged heading stands in the first of its cells
                last = name or (last if n_rows else "")
                names[k] = f"{last} {names[k]}".strip()
            n_rows += 1
        elif line.strip():
            break

    return names


def _as_wide(row: Cells, cells: Cells, widths: Sequence[int]) -> Cells:
    """A row above the cells of a line as names, one a column; [] where it is no heading.

    widths: how many cells stand below each name.
    """
    wide: Cells = []
    if len(row) == len(widths):
        for name, width in zip(row, widths, strict=True):
            wide += [f"{name}.{k}" for k in range(width)] if width > 1 else [name]
    elif len(row) == len(cells) + 1 and not row[-1]:
        wide = row[:-1]
    elif len(row) == len(cells) - 1 > 0:
        # pandas and R write no name above row names; others end their rows by a separator
        wide = ["", *row] if cells[-1] else [*row, ""]
    return ["" if STAMP.fullmatch(name) else name for name in wide]


def _unique(cells: Cells) -> Cells:
    """Names for columns: an empty cell gets a number, a name that occurs again another."""
    names = [cell.strip(' "') or f"column{k}" for k, cell in enumerate(cells, 1)]
    counts = [names[: k + 1].count(name) for k, name in enumerate(names)]
    pairs = zip(names, counts, strict=True)
    return [f"{name}.{count}" if count > 1 else name for name, count in pairs]
