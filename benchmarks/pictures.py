"""Pictures of `python -m benchmarks WHAT`: one function a measure, figures in, SVG out."""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from typing import NamedTuple

from benchmarks.cost.picture import figure as cost_figure
from benchmarks.cost.picture import on_hands
from holdfast.core.contract import Json
from holdfast.evaluation.style import GRID, INK, OURS, QUIET, WARNING, drawing, svg

Figures = Json
"""What WHAT.json holds."""
WIDTH_IN = 7.6
COLOURS = (OURS, WARNING, INK, QUIET, "#5b8c5a")


class Bar(NamedTuple):
    """One figure. marked: in our colour, the others are grey."""

    name: str
    value: float
    marked: bool


def effects(figures: Figures) -> str:
    """What every effect of a scene costs a sample, the dearest first."""
    rows = sorted(figures["prices"], key=lambda row: -float(row["ns_per_sample"]))
    bars = [
        Bar(row["effect"], row["ns_per_sample"], row["stage"] == "core") for row in rows
    ]
    return _bars(bars, 0.22, "ns a sample", xscale="log")


def hand(figures: Figures) -> str:
    """A scan of six fingers by bridge, layout and clock."""
    bars = []
    for row in figures["scans"]:
        name = f"{row['bridge']}, {row['layout']}, {row['bus_khz']} kHz"
        bars.append(Bar(name, row["scan_ms"], bool(row["serves_model_hz"])))
    of = "ms a scan of six fingers, of the virtual hand; grey: too slow for any model"
    return _bars(bars, 0.24, of, xscale="log")


def simulator(figures: Figures) -> str:
    """What the slip time's error costs in CPU time, step by step."""
    curves = {}
    for percent in (50, 90):
        curves[f"{percent} % of slips"] = [
            (1e3 * row["cpu_s_per_trial"], row[f"p{percent}_ms"])
            for row in figures["step"]
        ]
    return _curves(
        curves,
        "CPU ms a trial; every point half the step of the one before",
        "error of the slip's time, ms",
    )


def cost(figures: Figures) -> str:
    """Found in time against microseconds and milliseconds."""
    return cost_figure(figures["rows"])


def robust(figures: Figures) -> str:
    """Found in time on other hands."""
    return on_hands(figures["rows"])


PICTURES: dict[str, Callable[[Figures], str]] = {
    "cost": cost,
    "robust": robust,
    "effects": effects,
    "hand": hand,
    "simulator": simulator,
}


def _bars(bars: Sequence[Bar], height_in: float, xlabel: str, **scale: str) -> str:
    """A bar for each figure; height_in: of one."""
    with drawing(WIDTH_IN, height_in * len(bars) + 0.8) as figure:
        axes = figure.subplots()
        colours = [OURS if one.marked else QUIET for one in bars]
        axes.barh(range(len(bars)), [one.value for one in bars], color=colours)
        for place, one in enumerate(bars):
            places = ".3g" if one.value < 1000 else ".0f"
            axes.annotate(
                f"{one.value:,{places}}",
                (one.value, place),
                (3, 0),
                textcoords="offset points",
                va="center",
                fontsize=7,
            )
        axes.set_yticks(range(len(bars)), [one.name for one in bars])
        axes.invert_yaxis()
        axes.set(xlabel=xlabel, **scale)
        return svg(figure)


def _curves(
    curves: Mapping[str, Sequence[tuple[float, float]]], xlabel: str, ylabel: str
) -> str:
    """Lines on two logarithmic axes, each named at its last point."""
    with drawing(WIDTH_IN, 3.6) as figure:
        axes = figure.subplots()
        for place, (name, points) in enumerate(curves.items()):
            colour = COLOURS[place % len(COLOURS)]
            xs, ys = zip(*points, strict=True)
            axes.plot(xs, ys, "o-", markersize=4, color=colour, label=name)
        axes.set(xlabel=xlabel, ylabel=ylabel, xscale="log", yscale="log")
        ticks = [at for at, _ in next(iter(curves.values()))]
        axes.set_xticks(ticks, [f"{at:.3g}" for at in ticks], minor=False)
        axes.set_xticks([], minor=True)
        axes.legend(frameon=False, fontsize=8)
        axes.grid(color=GRID)
        return svg(figure)
