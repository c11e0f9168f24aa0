"""The picture of where the time from a touch to a closing grip goes, by engine and rate.

Its figures are those of `holdfast bench latency`, one run a rate (`make latency`).
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence

from matplotlib.axes import Axes

from holdfast.core.contract import Json
from holdfast.evaluation.style import GRID, OURS, QUIET, WARNING, drawing, svg
from holdfast.simulation.loop.drive import Drive

COMPUTED = {"convert": QUIET, "step": OURS, "decide": "#009e73", "emit": WARNING}
"""Stages of the live loop that are ours, and their colours."""
WAY = {
    "wait for the sample": GRID,
    "bus": QUIET,
    "computing": OURS,
    "lag of the drive": WARNING,
}
"""Parts of the way, and their colours."""


def picture(figures: Sequence[Json]) -> str:
    """Left the whole way in ms, right our part of it in us. figures: of latency.json, by rate."""
    computed: dict[str, dict[str, float]] = {}
    way: dict[str, dict[str, float]] = {}
    for one in figures:
        for engine in dict.fromkeys(row["engine"] for row in one["way"]):
            name = f"{engine}, {one['rate_hz']:g} Hz"
            of = stages_us(one, engine)
            computed[name] = {stage: of[stage] for stage in COMPUTED}
            way[name] = way_ms(of, one["rate_hz"])

    with drawing(9.4, 0.36 * len(way) + 1.5) as drawn:
        left, right = drawn.subplots(1, 2, sharey=True)
        _stacked(left, way, WAY, "ms from a touch until the drive moves")
        _stacked(right, computed, COMPUTED, "of which computing, us")
        left.invert_yaxis()
        return svg(drawn)


def stages_us(figures: Json, engine: str) -> dict[str, float]:
    """Medians of the live loop's stages with an engine."""
    rows = [row for row in figures["way"] if row["engine"] == engine]
    return {row["stage"]: row["p50_us"] for row in rows}


def way_ms(of: Mapping[str, float], rate_hz: float) -> dict[str, float]:
    """The parts of the way. of: medians of the stages, us."""
    return {
        # a touch comes at any moment between two samples
        "wait for the sample": 0.5e3 / rate_hz,
        "bus": 1e-3 * of["read"],
        "computing": 1e-3 * sum(of[stage] for stage in COMPUTED),
        # assumed, as in the closed loop
        "lag of the drive": Drive().lag_ms,
    }


def _stacked(
    axes: Axes,
    bars: Mapping[str, Mapping[str, float]],
    colours: Mapping[str, str],
    xlabel: str,
) -> None:
    ends = [0.0] * len(bars)
    for part, colour in colours.items():
        lengths = [one[part] for one in bars.values()]
        axes.barh(range(len(bars)), lengths, left=ends, color=colour, label=part)
        ends = [end + length for end, length in zip(ends, lengths, strict=True)]
    for place, end in enumerate(ends):
        axes.annotate(
            f"{end:,.3g}",
            (end, place),
            (3, 0),
            textcoords="offset points",
            va="center",
            fontsize=7,
        )
    axes.set_yticks(range(len(bars)), list(bars))
    axes.set_xlabel(xlabel)
    axes.margins(x=0.12)
    axes.legend(
        frameon=False,
        fontsize=7,
        ncols=4,
        loc="lower center",
        bbox_to_anchor=(0.5, 1.0),
    )
