"""The picture of `make bench NAME=latency`."""

from __future__ import annotations

from benchmarks.latency import OWN
from holdfast.core.contract import Json
from holdfast.evaluation.style import OURS, QUIET, WARNING, drawing, svg
from holdfast.live.bench import FLOOR, GRIP, STEP

COLOURS = {STEP: OURS, GRIP: OURS, OWN: OURS, FLOOR: WARNING}
"""Of calls in the picture; all others are quiet."""


def latency(figures: Json) -> str:
    """Half, 99 % and 99.9 % of the calls."""
    rows = figures["rows"]
    with drawing(7.6, 0.34 * len(rows) + 0.9) as drawn:
        axes = drawn.subplots()

        for place, row in enumerate(rows):
            colour = COLOURS.get(row["what"], QUIET)
            median = row["p50"]
            # The tail decides whether a sample is late, so it is drawn as far as it reaches.
            tail = [row["p99"], row["p99.9"]]
            axes.plot([median, *tail], [place] * 3, "-", color=colour, linewidth=2)
            axes.plot([median], [place], "o", color=colour, markersize=5)
            axes.plot(tail, [place] * 2, "|", color=colour, markersize=8)
            axes.annotate(
                f"{median:,.0f}",
                (median, place),
                (0, 5),
                textcoords="offset points",
                ha="center",
                fontsize=7,
            )

        names = [row["what"] for row in rows]
        axes.set_yticks(range(len(rows)), names)
        axes.set_xlabel("us a decision: median, and 99 and 99.9 % of the calls")
        # Calls differ by a factor of a hundred.
        axes.set_xscale("log")
        # The first row stands on top, as in the table.
        axes.invert_yaxis()
        return svg(drawn)
