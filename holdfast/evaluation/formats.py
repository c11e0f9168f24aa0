"""How numbers are written for people: in reports, in tables of documents, on a terminal.

"-" stands where a figure is not defined; an interval that is not defined is not written at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from holdfast.training.figures import ABSENT, Interval


def number(value: float | None, places: int = 2) -> str:
    """So many decimal places; "-" where there is no figure."""
    return ABSENT if value is None else f"{value:.{places}f}"


def milliseconds(seconds: float | None) -> str:
    """A time in s as whole ms."""
    return number(None if seconds is None else 1e3 * seconds, 0)


def whole(value: float) -> str:
    """Rounded to a whole number, never "-0"."""
    return str(round(value))


def percent(value: float | None) -> str:
    """A share as a percentage; "-" where there is none."""
    return ABSENT if value is None else f"{100 * value:.1f} %"


def interval(ends: Interval | None, places: int = 2) -> str:
    """From one end to the other, or nothing."""
    if ends is None:
        return ""
    low, high = ends
    return f"{low:.{places}f} to {high:.{places}f}"


def percent_interval(ends: Interval | None) -> str:
    """An interval of a share, as percentages."""
    return "" if ends is None else interval((100 * ends[0], 100 * ends[1]), 1)


def p_value(p: float) -> str:
    """The p of a test, to three places."""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def spaced(name: str) -> str:
    """A name of the contract as words: safe slip."""
    return name.replace("_", " ")


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a table of a document; all have the columns of the first."""
    heads = list(rows[0])
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        lines.append([markdown_cell(row[head]) for head in heads])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def markdown_cell(value: Any) -> str:
    """A cell of such a table: three digits of a number, or thousands with commas."""
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return ABSENT if value is None else str(value)
