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
from dataclasses import dataclass
from functools import lru_cache

from holdfast.core.column_map import MINUS
from holdfast.core.contract import Json
from holdfast.core.errors import ColumnError

SPACES = " "
"""Any number of them, or of tabs, between two cells."""
SEPARATORS = ("\t", ";", "|", ",", SPACES)
SIGNS = ((".", ""), (",", "."), (",", ""), (".", ","))
"""Before the fraction of a number, and between its thousands."""
THOUSANDS = re.compile(r"(?<=\d)[ \xa0\u202f'\u2019](?=\d{3}(?!\d))")
"""Between thousands, never before a fraction: a space, also a narrow one, or an apostrophe."""
COMMENTS = (
    "#", "%", "//", "!", "***", "Channels\t", "Samples\t", "Date\t", "Time\t", "Y_Unit_Label\t",
    "X_Dimension\t", "X0\t", "Delta_X\t", "X_Value\t",
)  # fmt: skip
"""How a line begins that is no row. The longer ones are of LabVIEW, whose heads have as many cells
as rows, and stand again above each segment.
"""
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
STAMP = re.compile(
    rf"(?:\d\d?[-./](?:\d\d?|[A-Z][a-z]{{2}})[-./]\d{{4}}[T ])?{CLOCK}"
    r"\s*(?:Z|[AP]M|[+-]\d\d:?\d\d)?"
)
_NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:e[-+]?\d+)?"
KNOWN = re.compile(rf"(?i:{_NUMBER})(?: sec)?|{STAMP.pattern}")
"""A cell that says something; MATLAB writes `sec` behind a duration."""
_CELL = rf"(?:{_NUMBER}|nan|none|null)"
GAP = r"[\s,;]+"
"""Between the numbers of a vector."""
VECTOR = re.compile(rf'(?i)"?[\[(]\s*({_CELL}(?:{GAP}{_CELL})*)[\s,;]*[\])]"?')
"""Numbers in brackets, and nothing else: a unit such as (0.01 N) is none."""
JOINT = "\x1f"
"""Between the numbers of a vector that stays one cell."""
PAIR = re.compile(r"(?<![^\s,;|])([^\W\d][\w.\[\]]*)\s*[:=]\s*(?=\S)")
FEWEST_PAIRS = 3
"""A name before a cell, as for the plotter of a serial monitor; more than so many in a line."""
NUMBER_HZ = r"(?<![\d.,])(\d+(?:\.\d+)?)"
RATE = re.compile(
    r"(?im)(?:^\W*rate|\bfs|\b(?:sampl\w*|acqui\w*|scan|abtast)[-_ ]*(?:rate|freq\w*?))(?![a-z])"
    rf"(?:.*?(?={NUMBER_HZ}[\s,;]*hz)|(?:(?!\b[mu]?s\b)[^\dk\n])*(?={NUMBER_HZ}\W*$))"
    rf"|^(?-i:(?:ANALOG_)?FREQUENCY)\t(?=[1-9]){NUMBER_HZ}$"
    rf"|^\W*(?:devices|trajectories|model outputs)\W*\n(?={NUMBER_HZ}\W*$)"
)
"""What a line above the names says of the rate, in Hz; of Vicon, the line below a block's name."""
PERIOD = re.compile(
    r"(?im)(?:^delta_x\s+"
    r"|\bsampl\w*[-_ ]*(?:rate|period|interval)(?=.*\b(ms)\b)\W+(?:ms\W+)?)"
    r"(?=[\d.,]*[1-9])(\d*[.,]?\d+(?:e-?\d+)?)"
)
"""What is said of the time between two rows, in s, by LabVIEW, or in ms."""
_UNIT = (
    r"(?-i:[mcdk]N|[muµ]T|gf)|kgf|lbf|ozf|(?:milli)?newtons?|gauss|(?:micro|milli)?teslas?"
    r"|(?:kilo)?grams?[- ]force|(?:pounds?|ounces?)[- ]force"
)
HEAD_UNIT = re.compile(
    r"(?im)(?:(?<![a-z])(?:units?|unités?|einheit(?:en)?)(?:[ _]label)?"
    r"(?:[ \t]*[:=,;\t][^\w\n]*|[ \t]+(?=\S+[ \t]*$))"
    r"|\b(?:forces?|readings?|values?|loads?)[ \t]+(?:are[ \t]+)?in[ \t]+"
    r"|^[#%!/](?!.*(?:mass|weight|gewicht)).*?[\[(](?=\w+[\])])"
    rf"|(?<![^\W_])(?<!\d )(?<!per )(?<!from )(?=(?:{_UNIT})[^\w\n]*$))"
    r"((?:\d[\d.,e^-]*[ \t]*)?[^\W\d_]+(?:[ \t]*(?:[*/x·×^]|per\b)[ \t]*[\w.^-]+)*)"
)
"""What the lines above the names say of units, also of other quantities: behind `unit` or `in`, a
word in brackets, a unit of force or field at the end of a line. One with a factor is asked.
"""
GROUPED = re.compile(r"[-+]?[1-9]\d{0,2}([,.]\d{3})+([.,]\d*)?")
"""A number with a sign between its thousands."""
FRACTION = re.compile(
    r'(?m)(?<![^\s;|",])[-+]?(?:0(\.)\d+|\d+(\.)(?:\d\d?|\d{4,}))(?![^\s;|",])'
    r'|(?<![^\s;|"])[-+]?(?:0(,)\d+|\d+(,)(?:\d\d?|\d{4,}))(?![^\s;|"])'
)
"""A sign that stands before a fraction: other than three digits follow, or a zero is before it."""
LABVIEW = re.compile(r"^X_Value(?=\t.*\tComment\s*$)")
MOST_HEADING_ROWS = 3
"""Groups, names and units."""
Cells = list[str]


@dataclass(frozen=True)
class Form:
    """How lines become cells. thousands: the sign between them, "" for none.

    has_names: whether each cell of a line has its name before it.
    """

    separator: str
    decimal: str
    thousands: str
    has_names: bool

    def cells(self, line: str, joint: str = "") -> Cells:
        """The cells of a line. joint: what joins the numbers of a vector, where it is one cell."""
        mark = self.separator
        # programs that write for people write a longer minus
        line = line.replace("\N{MINUS SIGN}", MINUS)
        line = ARRIVAL.sub(rf"\1\2{mark}", line)
        line = VECTOR.sub(lambda found: re.sub(GAP, joint or mark, found[1]), line)
        if self.has_names:
            line = PAIR.sub("", line)
        if mark == SPACES:
            # a space that does not break stands within a cell
            line = re.sub(r"(\d) (?=\d\d?:\d\d:)", r"\1T", line)
            return re.split("[ \t]+", line.strip())
        # a power cut leaves zeros at the end
        reader = csv.reader([line.strip(" \r\n\0")], delimiter=mark)
        cells = [cell.strip() for row in reader for cell in row]
        return [
            cell.replace(self.thousands, "") if GROUPED.fullmatch(cell) else cell
            for cell in cells
        ]

    def share(self, cells: Sequence[str]) -> float:
        """How many of the cells that hold something are numbers, dates or times of day."""
        filled = [
            THOUSANDS.sub("", cell).replace(self.decimal, ".")
            for cell in cells
            if cell not in MISSING
        ]
        known = list(filter(KNOWN.fullmatch, filled))
        return len(known) / max(1, len(filled))


@dataclass(frozen=True)
class TableLayout:
    """names: of the columns. first_row: index of the first line of numbers; heading: that above it.

    is_plain: whether pandas can read the lines as they stand. numeric: the columns that hold
    numbers in the first lines. about: what the lines above the names say: the rate, None where they
    say none, and words of units.
    """

    form: Form
    names: Cells
    first_row: int
    is_plain: bool
    numeric: Cells
    about: Json
    heading: str


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
    numbers = "\n".join(filter(KNOWN.match, data))
    decimals = {max(found) for found in FRACTION.findall(numbers)}
    forms = [
        Form(one, *two, has_names)
        for one in SEPARATORS
        for two in SIGNS
        if two[0] in (decimals or ".,") and two[1] not in decimals
    ]
    form = max(forms, key=lambda one: _fit(one, judged))
    share, wide = _fit(form, judged)
    if not share:
        raise ColumnError(
            "no table of several columns",
            cause="another kind of file, or a separator that is not a tab, a semicolon, a bar, "
            "a comma or spaces",
            next_step="save it as CSV",
        )

    rows = [form.cells(line) for line in data]
    # a heading may begin with a time of arrival
    are_data = [len(row) == wide and form.share(row) > 0.5 * share for row in rows]
    first = are_data.index(True)
    # a time in s, of LabVIEW
    head = [
        LABVIEW.sub("X_Value [s]", line) for line in filter(str.strip, lines[:first])
    ]
    names = _unique(_heading(head, data[first], form))
    whole = [row for row in rows[first:] if len(row) == wide]
    columns = zip(names, *whole, strict=True)
    numeric = [name for name, *cells in columns if form.share(cells) >= 0.5]
    # all that stands in a line but its cells
    between = re.compile(rf'[\s"{form.separator}]')
    cells = "".join("".join(row) for row in rows[first:])
    is_plain = between.sub("", "".join(data[first:])) == between.sub("", cells)
    heading = lines[first - 1].strip()
    return TableLayout(form, names, first, is_plain, numeric, _about(head), heading)


def _fit(form: Form, lines: Sequence[str]) -> tuple[float, int]:
    """(the share of numbers in lines that a form reads, how many cells most of them have)."""
    rows = [form.cells(line) for line in lines]
    counts = Counter(map(len, rows))
    wide = max(counts, key=lambda cells: (counts[cells], cells), default=0)
    cells = [cell for row in rows for cell in row if len(row) == wide]
    share = form.share(cells) * counts[wide] / len(rows) if wide > 1 else 0.0
    return round(share, 3), wide


def _about(head: Sequence[str]) -> Json:
    """The rate, Hz, and the words of units in the lines above a table."""
    text = "\n".join(head)
    rates = {float(max(found)) for found in RATE.findall(text)}
    for ms, step in PERIOD.findall(text):
        rates.add((1000.0 if ms else 1.0) / float(step.replace(",", ".")))
    rate_hz = rates.pop() if len(rates) == 1 else None
    return {"rate_hz": rate_hz, "unit": " ".join(HEAD_UNIT.findall(text))}


# -- names


def _heading(above: Sequence[str], data: str, form: Form) -> Cells:
    """A name for each cell of the first line of data, by the lines above it.

    The numbers of a vector are force.0, force.1, ..
    """
    below = form.cells(data, JOINT)
    names = [""] * len(below)
    if form.has_names:
        pairs = PAIR.findall(ARRIVAL.sub("", data))
        above = [form.separator.join(pairs)]
    for line in reversed(above[-MOST_HEADING_ROWS:]):
        row = form.cells(line.lstrip(" #%/!"))
        if len(row) == len(below) - 1:
            # a time of arrival has no name, and none stands above the row names of pandas and R;
            # others end their rows by a separator
            row = ["", *row] if below[-1] else [*row, ""]
        if row[-1:] == ["Comment"] and len(row) > len(below):
            # rows without one leave it out
            row.pop()
        if len(row) != len(below):
            break
        is_group, last = any(names), ""
        for k, cell in enumerate(row):
            name = "" if STAMP.fullmatch(cell) else cell
            # above other names, a merged heading stands in the first of its cells
            last = name or (last if is_group else "")
            names[k] = f"{last} {names[k]}".strip()

    wide: Cells = []
    for name, cell in zip(names, below, strict=True):
        numbers = cell.split(JOINT)
        is_wide = name and len(numbers) > 1
        wide += [f"{name}.{k}" if is_wide else name for k in range(len(numbers))]
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
