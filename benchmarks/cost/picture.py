"""The figure of docs/what-accuracy-costs.md: slips acted on in time, by computing and waiting."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from benchmarks.cost.point import (
    COMMITTEE,
    POOLED,
    RATES,
    RAW,
    SHIPPED,
    SIZES,
    SLOWER_DECISIONS,
    TINY,
    Point,
)
from holdfast.core.contract import Json
from holdfast.evaluation.style import GRID, INK, OURS, WARNING, drawing, svg

OTHERS = "#009e73"
COMPUTED = {
    "trees and depth": (OURS, SIZES),
    "learner": (WARNING, (Point(learner="network"), COMMITTEE)),
    "features": (OTHERS, (Point(groups=RAW), Point(groups=POOLED))),
}
WAITED = {
    "debounce": (OURS, SLOWER_DECISIONS),
    "sampling rate": (WARNING, RATES),
}
"""Families of points that a panel draws in one colour."""
MARKED = {"reference": Point(), "shipped": SHIPPED, "tiny": TINY}
"""Points with a name of their own, in black."""
Families = dict[str, tuple[str, tuple[Point, ...]]]
Measure = Callable[[Json], float | None]


def figure(rows: Sequence[Json]) -> str:
    """Scenes: slips acted on before gross slip, against microseconds and against the delay."""
    by_name = {row["what"]: row for row in rows if row["of"] == "scenes"}
    with drawing(9.4, 4.0) as drawn:
        drawn.suptitle(
            "simulated", x=0.995, ha="right", fontsize=8, color=WARNING, style="italic"
        )
        left, right = drawn.subplots(1, 2, sharey=True)
        _panel(left, by_name, COMPUTED, _step_us)
        _panel(right, by_name, WAITED, _delay_ms)
        left.set_xscale("log")
        left.xaxis.set_major_formatter("{x:g}")
        left.xaxis.set_minor_locator(LogLocator(subs=(2.0, 4.0, 6.0, 8.0)))
        left.xaxis.set_minor_formatter("{x:g}")
        left.set(
            xlabel="computing: one decision as deployed, us",
            ylabel="risky slips acted on before gross slip,\nat about one false alarm a minute",
        )
        right.set(xlabel="waiting: load onset to the request, ms (median)")
        return svg(drawn)


def _panel(
    axes: Axes, by_name: dict[str, Json], families: Families, measure: Measure
) -> None:
    """Dots of every family that was measured, each with its name, and the marked points."""
    for family, (colour, points) in families.items():
        label = family
        for point in points:
            if point.what in by_name:
                _dot(axes, by_name[point.what], measure, colour, point.what, label)
                # once in the legend
                label = "_"
    for name, point in MARKED.items():
        if point.what in by_name:
            _dot(axes, by_name[point.what], measure, INK, name, "_")
    axes.legend(
        frameon=False,
        fontsize=8,
        ncols=3,
        loc="lower left",
        bbox_to_anchor=(0.0, 1.0),
    )
    axes.grid(color=GRID)
    axes.margins(x=0.2)


def _dot(
    axes: Axes, row: Json, measure: Measure, colour: str, name: str, label: str
) -> None:
    x = measure(row)
    if x is None:
        return
    axes.plot(x, row["in_time"], "o", color=colour, markersize=5, label=label)
    place = (x, row["in_time"])
    axes.annotate(
        name, place, (5, 4), textcoords="offset points", fontsize=7, color=colour
    )


def _step_us(row: Json) -> float:
    return float(row["step_us"])


def _delay_ms(row: Json) -> float | None:
    return float(row["delay_ms"]["p50"]) if row["delay_ms"] else None
