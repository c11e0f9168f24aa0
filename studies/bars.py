"""One figure a row with its interval, as the tables of studies draw them."""

from __future__ import annotations

from collections.abc import Sequence
from typing import NamedTuple

from matplotlib.axes import Axes

from holdfast.evaluation.style import GRID, OURS, QUIET, WARNING

ROW_COLOURS = {"ours": OURS, "warning": WARNING, "": QUIET}
"""By the class of a row, as the tables of a report have it."""


class Bar(NamedTuple):
    """A figure with its interval. row_class: ours, warning, or nothing."""

    value: float
    interval: Sequence[float]
    row_class: str = ""


def bar(
    value: float | None, interval: Sequence[float] | None, row_class: str = ""
) -> Bar:
    """A bar; there is nothing to draw where the figure or its interval is not defined."""
    absent = float("nan")
    # Matplotlib draws nothing at nan, so the row stays empty and keeps its place.
    centre = absent if value is None else value
    return Bar(centre, interval or (absent, absent), row_class)


def bars(axes: Axes, rows: Sequence[Bar], title: str, start: float) -> None:
    """One figure a row with its interval; this model and warnings in colours of their own."""
    for place, (value, interval, row_class) in enumerate(rows):
        colour = ROW_COLOURS[row_class]
        axes.plot(
            interval,
            [place, place],
            color=colour,
            linewidth=5,
            alpha=0.35,
            solid_capstyle="butt",
        )
        axes.plot(value, place, "o", color=colour, markersize=6)
        axes.annotate(
            f"{value:.3f}",
            (value, place),
            (0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )

    axes.set_xlim(left=start)
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(axis="x", color=GRID)
    axes.set_axisbelow(True)
