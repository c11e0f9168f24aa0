"""Figures as the text of a table's cell: a value, and in small below it what it may be between."""

from __future__ import annotations

from holdfast.evaluation.closing_hand import KeptObjects
from holdfast.evaluation.statistics import McNemar, Spread
from holdfast.training.figures import ABSENT, Interval, LevelF1, Share, over


def number(value: float | None, places: int = 2) -> str:
    """So many decimal places; "-" where there is no figure."""
    return ABSENT if value is None else f"{value:.{places}f}"


def percent(value: float | None) -> str:
    """A share as a percentage; "-" where there is none."""
    return ABSENT if value is None else f"{100 * value:.1f} %"


def interval(edges: Interval | None, places: int = 2) -> str:
    """From one edge to the other, or nothing."""
    return " to ".join(f"{edge:.{places}f}" for edge in edges) if edges else ""


def percent_interval(edges: Interval | None) -> str:
    """The same of a share, as percentages."""
    return " to ".join(f"{100 * edge:.1f}" for edge in edges) if edges else ""


def with_interval(value: float | None, edges: Interval | None, places: int = 2) -> str:
    """A number above its interval."""
    return above(number(value, places), interval(edges, places))


def macro_f1_cell(of: LevelF1) -> str:
    """A macro F1 above its interval, and above what it is over where a class is absent."""
    return above(with_interval(of.macro_f1, of.macro_f1_ci, 3), over(of.f1))


def percent_with_interval(value: float | None, edges: Interval | None) -> str:
    """A percentage above its interval."""
    return above(percent(value), percent_interval(edges))


def share_cell(of: Share) -> str:
    """A share with its exact interval."""
    return percent_with_interval(of.share, of.share_ci)


def median(of: Spread | None) -> str:
    """The median alone, rounded; "-" where there is none."""
    return ABSENT if of is None else f"{of.p50:.0f}"


def spread_cell(of: Spread | None) -> str:
    """The median above the 5th to 95th percentile."""
    if of is None:
        return ""
    return above(f"{round(of.p50)}", f"{round(of.p5)} to {round(of.p95)}")


def percent_spread_cell(of: Spread | None) -> str:
    """The same of shares."""
    if of is None:
        return ""
    return above(f"{100 * of.p50:.0f} %", f"{100 * of.p5:.0f} to {100 * of.p95:.0f}")


def kept_cell(closing: KeptObjects | None) -> str:
    """Objects that the closing hand keeps, of those it can keep."""
    return "" if closing is None else f"{closing.kept} of {closing.preventable}"


def p_cell(against: McNemar | None) -> str:
    """McNemar's p; nothing for the method itself."""
    if against is None:
        return ""
    return "&lt; 0.001" if against.p < 0.001 else f"{against.p:.3f}"


def above(value: str, below: str) -> str:
    """A value, and a note in small below it."""
    return f"{value}<br><span class=note>{below}</span>" if below else value
