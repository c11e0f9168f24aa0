"""How numbers and names of methods are written for people: reports, documents, terminals.

figures.json keeps the stored names. "-" stands where a figure is not defined; an interval that is
not defined is not written at all.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

from holdfast.training.figures import ABSENT, Interval

DEPLOYED = "ours, as deployed"
CHOSEN = "ours, confidence chosen"
BAND = "band-pass bank"
CONE = "friction cone"
SHEAR_RATE = "one line of code"
RAW = "raw-window forest"
ORACLE = "perfect intent"
DISPLAY_NAMES = {
    DEPLOYED: "this model, as deployed",
    CHOSEN: "this model, chosen confidence",
    SHEAR_RATE: "shear-rate threshold",
    ORACLE: "oracle",
}
"""Stored name -> the name that people read, where they differ."""
LAWS = {
    BAND: "a shear signal exceeds its own noise floor in one of ten bands (setting: ratio)",
    CONE: "shear / normal force of a finger leaves the friction cone (setting: coefficient)",
    SHEAR_RATE: "summed shear changes within two samples by more than a threshold (setting: N)",
    RAW: "the thesis' forest: 100 untuned trees on the last 0.10 s (setting: confidence)",
    ORACLE: "an upper bound: knows the person's intent, acts one sample after load onset",
}
"""How each baseline decides, and what its setting is."""


def number(value: float | None, places: int = 2) -> str:
    """So many decimal places; "-" where there is no figure."""
    return ABSENT if value is None else f"{value:.{places}f}"


def whole(value: float) -> str:
    """Rounded to a whole number, never "-0"."""
    # round() gives an int, which has no sign at 0.
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
    if ends is None:
        return ""
    low, high = ends
    return interval((100 * low, 100 * high), 1)


def p_value(p: float) -> str:
    """The p of a test, to three places."""
    return "< 0.001" if p < 0.001 else f"{p:.3f}"


def spaced(name: str) -> str:
    """A name of the contract as words: safe slip."""
    return name.replace("_", " ")


def display_name(stored: str) -> str:
    """A stored name as people read it.

    >>> display_name("one line of code"), display_name("friction cone")
    ('shear-rate threshold', 'friction cone')
    """
    return DISPLAY_NAMES.get(stored, stored)


def is_this_model(stored: str) -> bool:
    """Whether a stored name is the evaluated model and no baseline."""
    return stored in (DEPLOYED, CHOSEN)


def markdown(rows: Sequence[Mapping[str, Any]]) -> str:
    """Rows as a table of a document; all have the columns of the first."""
    heads = list(rows[0])
    lines = [heads, ["---"] * len(heads)]
    for row in rows:
        # By name: a row may hold further figures that are no column.
        lines.append([markdown_cell(row[head]) for head in heads])
    return "\n".join("| " + " | ".join(line) + " |" for line in lines)


def markdown_cell(value: Any) -> str:
    """A cell of such a table: three digits of a number, or thousands with commas."""
    if isinstance(value, float):
        return f"{value:,.0f}" if abs(value) >= 1000.0 else f"{value:.3g}"
    return ABSENT if value is None else str(value)


def onsets_in_words(by: Mapping[str, int]) -> str:
    """What gave the load onsets, where a camera or a person did; "" for a scene or a script."""
    # A scene and a script know their onsets exactly, and need no such note.
    if not by.keys() & {"camera", "key"}:
        return ""
    counts = ", ".join(f"{name} {count}" for name, count in by.items())
    return (
        f"source of load onsets: {counts}; a camera gives the object's first motion, a pressed key "
        "is late"
    )
