"""Pictures of `python -m benchmarks WHAT`: one function a measure, figures in, SVG out."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from benchmarks.cost.picture import figure as cost_figure
from holdfast.core.reading import Json
from holdfast.evaluation.latency.picture import latency
from holdfast.evaluation.style import INK, OURS, QUIET, STYLE, WARNING, svg

Figures = Json
"""What WHAT.json holds."""


def effects(figures: Figures) -> str:
    """What every effect of a scene costs a sample, the dearest first."""
    rows = sorted(figures["prices"], key=lambda row: -float(row["ns_per_sample"]))
    with mpl.rc_context(STYLE):
        drawn, axes = _figure(height=0.22 * len(rows) + 0.8)
        colours = [OURS if row["stage"] == "core" else QUIET for row in rows]
        _bars(
            axes,
            [row["effect"] for row in rows],
            [row["ns_per_sample"] for row in rows],
            colours,
        )
        axes.set(xlabel="ns a sample", xscale="log")
        return svg(drawn)


def training(figures: Figures) -> str:
    """CPU seconds of every stage against the number of trials."""
    rows = figures["rows"]
    return _curves(
        [
            (
                name.removesuffix("_cpu_s").replace("_", " "),
                [(row["trials"], row[name]) for row in rows],
            )
            for name in rows[0]
            if name.endswith("_cpu_s")
        ],
        "trials",
        "CPU seconds",
    )


def instructions(figures: Figures) -> str:
    """Instructions a call."""
    with mpl.rc_context(STYLE):
        rows = figures["rows"]
        drawn, axes = _figure(height=0.4 * len(rows) + 0.8)
        _bars(
            axes,
            [row["what"] for row in rows],
            [row["instructions"] for row in rows],
            [OURS] * len(rows),
        )
        axes.set(xlabel="instructions a call (callgrind)")
        return svg(drawn)


def hand(figures: Figures) -> str:
    """A scan of six fingers by bridge, layout and clock."""
    rows = figures["scans"]
    names = [
        f"{row['bridge']}, {row['reads']}, {row['layout']}, {row['bus_khz']} kHz"
        for row in rows
    ]
    with mpl.rc_context(STYLE):
        drawn, axes = _figure(height=0.24 * len(rows) + 0.8)
        _bars(
            axes,
            names,
            [row["scan_ms"] for row in rows],
            [OURS if row["serves_model_hz"] else QUIET for row in rows],
        )
        axes.set(
            xlabel="ms a scan of six fingers, of the virtual hand; grey: too slow for any model",
            xscale="log",
        )
        return svg(drawn)


def simulator(figures: Figures) -> str:
    """What the slip time's error costs in CPU time, step by step."""
    rows = figures["step"]
    points = [
        (
            f"{name} % of slips",
            [(1e3 * row["cpu_s_per_trial"], row[key]) for row in rows],
        )
        for name, key in ((50, "p50_ms"), (90, "p90_ms"))
    ]
    return _curves(
        points,
        "CPU ms a trial; every point half the step of the one before",
        "error of the slip's time, ms",
    )


def onset(figures: Figures) -> str:
    """Error of the slip's start against the object's acceleration."""
    rows = figures["ramps"]
    rates = dict.fromkeys(row["fps"] for row in rows)
    return _curves(
        [
            (
                f"{fps:g} fps",
                [
                    (row["mm_per_s2"], row["start_worst_ms"])
                    for row in rows
                    if row["fps"] == fps
                ],
            )
            for fps in rates
        ],
        "acceleration, mm/s2",
        "worst error of the slip's start, ms",
    )


def cost(figures: Figures) -> str:
    """Found in time against microseconds and milliseconds."""
    return cost_figure(figures["rows"])


PICTURES: dict[str, Callable[[Figures], str]] = {
    "latency": latency,
    "cost": cost,
    "training": training,
    "instructions": instructions,
    "effects": effects,
    "hand": hand,
    "onset": onset,
    "simulator": simulator,
}


def _figure(height: float) -> tuple[Figure, Axes]:
    drawn = Figure(figsize=(7.6, height))
    return drawn, drawn.subplots()


def _bars(
    axes: Axes, names: Sequence[str], values: Sequence[float], colours: Sequence[str]
) -> None:
    axes.barh(range(len(names)), list(values), color=list(colours))
    for place, value in enumerate(values):
        axes.annotate(
            f"{value:,.3g}" if value < 1000 else f"{value:,.0f}",
            (value, place),
            (3, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
        )
    axes.set_yticks(range(len(names)), list(names))
    axes.invert_yaxis()


def _curves(
    curves: Sequence[tuple[str, Sequence[tuple[float, float]]]], x: str, y: str
) -> str:
    """Lines on two logarithmic axes, each named at its last point."""
    with mpl.rc_context(STYLE):
        drawn, axes = _figure(height=3.6)
        for place, (name, points) in enumerate(curves):
            axes.plot(
                [at for at, _ in points],
                [value for _, value in points],
                "o-",
                markersize=4,
                color=(OURS, WARNING, INK, QUIET, "#5b8c5a")[place % 5],
                label=name,
            )
        axes.set(xlabel=x, ylabel=y, xscale="log", yscale="log")
        axes.set_xticks(
            [at for at, _ in curves[0][1]],
            [f"{at:.3g}" for at, _ in curves[0][1]],
            minor=False,
        )
        axes.set_xticks([], minor=True)
        axes.legend(frameon=False, fontsize=8)
        axes.grid(color="#e4e7eb")
        return svg(drawn)
