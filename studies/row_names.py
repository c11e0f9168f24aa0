"""Names of the rows of the tables of studies: JSON keys, how each is shown and drawn."""

from __future__ import annotations

from holdfast.evaluation.formats import display_name

CLOCK = "WARNING: a clock, time since contact and summed force"
OURS_18 = "ours, 18 channels"
SPREAD_18 = "committee, 18 channels, spread taxels"
LEAKY_FOLDS = 2
LEAKY = f"WARNING: leaky, raw forest on random windows, {LEAKY_FOLDS} folds"
OURS_ROWS = frozenset({OURS_18})
WARNING_ROWS = frozenset({CLOCK, LEAKY})
"""Rows that warn of what a figure may hide; no detector is built like them."""
SHOWN = {
    CLOCK: "timing-only baseline",
    LEAKY: f"leaky split: raw forest on random windows, {LEAKY_FOLDS} folds",
}
"""JSON key -> the glossary's name, where they differ."""


def shown(row: str) -> str:
    """The name that tables and pictures show."""
    return SHOWN.get(row) or display_name(row)


def row_class(row: str) -> str:
    """The CSS class of a row in a report."""
    return "warning" if row in WARNING_ROWS else "ours" if row in OURS_ROWS else ""
