"""The figure of docs/what-accuracy-costs.md: slips acted on in time, by computing and waiting."""

from __future__ import annotations

from collections.abc import Callable, Sequence

from matplotlib.axes import Axes
from matplotlib.ticker import LogLocator

from benchmarks.cost.hands import HANDS, UNCHANGED
from benchmarks.cost.point import (
    DEBOUNCES,
    DEPTHS,
    ON_HANDS,
    POOLED,
    RATES_HZ,
    REFERENCE,
    SHIPPED,
    TREES,
    Point,
)
from holdfast.core.contract import Json
from holdfast.evaluation.style import GRID, INK, OURS, QUIET, WARNING, drawing, svg

COMPUTED = {
    "trees": [(f"{n}", Point(trees=n)) for n in TREES],
    "depth": [(f"{n or 'unlimited'}", Point(depth=n)) for n in DEPTHS],
    "learner": [(kind, Point(learner=kind)) for kind in ("network", "committee")],
    "features": [
        (name, Point(groups=name))
        for name in ("now", "now, differences", "raw window", POOLED)
    ],
}
WAITED = {
    "debounce, samples": [(f"{n}", Point(debounce=n)) for n in DEBOUNCES],
    "sampling rate, Hz": [(f"{hz:g}", Point(rate_hz=hz)) for hz in RATES_HZ],
}
"""Families of points that the figure draws as lines: (label, point)."""
FAMILY_COLOURS = (OURS, WARNING, "#009e73", QUIET)
UNORDERED = {"features", "learner"}
LABELLED = {
    "1",
    "2",
    "3",
    "500",
    "4",
    "50",
    "100",
    "300",
    "now",
    "raw window",
    "network",
    POOLED,
}
COMPARED = {
    "single fingers": Point(),
    "single fingers, committee": Point(learner="committee"),
    "pooled": Point(groups=POOLED),
    "pooled, committee (shipped)": SHIPPED,
}
"""Learners that the figure of other hands draws as lines."""
Families = dict[str, list[tuple[str, Point]]]
Measure = Callable[[Json], float | None]


def figure(rows: list[Json]) -> str:
    """Scenes: slips acted on before gross slip, against microseconds and against the delay."""
    by_name = {row["what"]: row for row in rows if row["of"] == "scenes"}
    with drawing(9.4, 4.0) as drawn:
        drawn.suptitle(
            "simulated", x=0.995, ha="right", fontsize=8, color=WARNING, style="italic"
        )
        left, right = drawn.subplots(1, 2, sharey=True)
        _panel(left, by_name, COMPUTED, _step_us)
        _marked(left, by_name, _step_us, (7, -12), "left")
        left.margins(x=0.2)
        left.legend(frameon=False, fontsize=8, loc="lower right")
        _panel(right, by_name, WAITED, _delay_ms)
        _marked(right, by_name, _delay_ms, (-6, -12), "right")
        right.legend(frameon=False, fontsize=8, loc="lower left")
        _label(left, right)
        return svg(drawn)


def on_hands(rows: list[Json]) -> str:
    """Slips acted on before gross slip, on each hand, and on the worst one against microseconds."""
    by_name = {row["what"]: row for row in rows if row["of"] == "scenes"}
    with drawing(9.4, 4.0) as drawn:
        drawn.suptitle(
            "simulated", x=0.995, ha="right", fontsize=8, color=WARNING, style="italic"
        )
        left, right = drawn.subplots(1, 2, sharey=True)
        for place, (colour, (name, point)) in enumerate(
            zip(FAMILY_COLOURS, COMPARED.items(), strict=True)
        ):
            _by_hand(left, by_name[point.what], name, colour, 0.06 * (place - 1.5))
        left.set_xticks(range(1 + len(HANDS)), ["held one way", *HANDS])
        left.set(ylabel="risky slips acted on before all fingers slide", ylim=(0, 1.02))
        left.legend(frameon=False, fontsize=8, loc="lower left")
        for point in ON_HANDS:
            row = by_name[point.what]
            is_pooled = point.groups != Point().groups
            worst = min(one["in_time"] for one in row["hands"].values())
            colour = FAMILY_COLOURS[2 if is_pooled else 0]
            right.plot(row["step_us"], worst, "o", color=colour, markersize=4.5)
        right.set(
            xlabel="computing: one decision, us; height: the worst of these hands"
        )
        right.grid(color=GRID)
        return svg(drawn)


def _by_hand(axes: Axes, row: Json, name: str, colour: str, aside: float) -> None:
    """One learner on every hand, with its 95 % intervals."""
    hands = [row["hands"][one] for one in (UNCHANGED, *HANDS)]
    middle = [one["in_time"] for one in hands]
    below = [one["in_time"] - one["in_time_ci"][0] for one in hands]
    above = [one["in_time_ci"][1] - one["in_time"] for one in hands]
    places = [aside + place for place in range(len(hands))]
    axes.errorbar(
        places,
        middle,
        (below, above),
        fmt="o",
        color=colour,
        markersize=4.5,
        label=name,
    )
    axes.grid(color=GRID, axis="y")


def _panel(
    axes: Axes, by_name: dict[str, Json], families: Families, measure: Measure
) -> None:
    for colour, (family, points) in zip(FAMILY_COLOURS, families.items(), strict=False):
        measured = [
            (by_name[point.what], name)
            for name, point in points
            if point.what in by_name
        ]
        drawn = [
            (x, row["in_time"], name)
            for row, name in measured
            if (x := measure(row)) is not None
        ]
        _family(axes, family, drawn, colour)
    axes.grid(color=GRID)
    axes.margins(x=0.1)


def _marked(
    axes: Axes,
    by_name: dict[str, Json],
    measure: Measure,
    beside: tuple[int, int],
    side: str,
) -> None:
    """The reference's dot and the shipped model's, each with its name."""
    dots = {
        REFERENCE: (Point().what, beside, side),
        "shipped": (SHIPPED.what, (7, 3), "left"),
    }
    for shown, (what, offset, towards) in dots.items():
        row = by_name.get(what)
        if row is None or (x := measure(row)) is None:
            continue
        axes.plot(x, row["in_time"], "o", color=INK, markersize=8, zorder=3)
        axes.annotate(
            shown,
            (x, row["in_time"]),
            offset,
            textcoords="offset points",
            fontsize=8,
            ha=towards,
        )


def _label(left: Axes, right: Axes) -> None:
    left.set_xscale("log")
    left.xaxis.set_major_formatter("{x:g}")
    left.xaxis.set_minor_locator(LogLocator(subs=(1.0, 2.0, 4.0, 6.0, 8.0)))
    left.xaxis.set_minor_formatter("{x:g}")
    left.set(
        xlabel="computing: one decision, us",
        ylabel="risky slips acted on before all fingers slide,\nat about one false alarm a minute",
    )
    right.set(xlabel="waiting: load onset to the request, ms (median)")


def _step_us(row: Json) -> float | None:
    return float(row["step_us"])


def _delay_ms(row: Json) -> float | None:
    return float(row["delay_ms"]["p50"]) if row["delay_ms"] else None


def _family(
    axes: Axes, family: str, points: Sequence[tuple[float, float, str]], colour: str
) -> None:
    """A line through the points of a family (dots where they have no order), some named."""
    line = "" if family in UNORDERED else "-"
    xs = [x for x, _, _ in points]
    ys = [y for _, y, _ in points]
    axes.plot(xs, ys, f"o{line}", color=colour, markersize=4.5, label=family)
    right = colour == OURS
    beside, side = ((5, 4), "left") if right else ((-6, -8 if line else -3), "right")
    beside, side = ((5, -9), "left") if family == "learner" else (beside, side)
    for x, y, name in points:
        if name in LABELLED:
            axes.annotate(
                name,
                (x, y),
                beside,
                textcoords="offset points",
                fontsize=7,
                color=colour,
                ha=side,
            )
