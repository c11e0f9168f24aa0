"""Two pictures of docs/results.md, late or in time and hand-overs called: `make docs`."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from matplotlib.axes import Axes

from holdfast.core.contract import Json
from holdfast.evaluation.formats import DEPLOYED
from holdfast.evaluation.style import GRID, INK, OURS, WARNING, drawing, svg
from tools.harness import for_any_page

WIDE_IN = 5.6


def late_or_in_time(figures: Json) -> str:
    """Of each set's risky events: acted on before gross slip, later, or not at all."""
    rows = {}
    for name, one in figures["sets"].items():
        if one["rows"][DEPLOYED]["events"]:
            rows[name] = one["rows"][DEPLOYED]
    return _picture(figures, rows, "events", "risky events", _parts)


def _parts(axes: Axes, rows: Json) -> None:
    in_time = np.array([row["in_time"] for row in rows.values()])
    found = np.array([row["recall"] for row in rows.values()])
    names = list(rows)
    axes.barh(names, in_time, 0.62, color=OURS, label="before gross slip")
    axes.barh(names, found - in_time, 0.62, in_time, color=WARNING, label="late")
    axes.barh(names, 1.0 - found, 0.62, found, color="#bbbbbb", label="not at all")
    axes.set_xlabel("share of risky events")


def hand_overs_called(figures: Json) -> str:
    """Of each set's voluntary actions: the share with an alarm, and its 95 % interval."""
    rows = {}
    for name, one in figures["sets"].items():
        called = one["rows"][DEPLOYED]["safe_acts_called"]
        if called and called["n"]:
            rows[name] = called
    return _picture(figures, rows, "n", "voluntary actions", _shares)


def _shares(axes: Axes, rows: Json) -> None:
    for place, row in enumerate(rows.values()):
        ends = [place, place]
        axes.plot(row["share_ci"], ends, color=WARNING, linewidth=7, alpha=0.4)
        axes.plot(row["share"], place, "o", color=INK, markersize=7)
    axes.set_yticks(range(len(rows)), list(rows))
    axes.set_xlim(left=0.0)
    axes.set_xlabel("share called risky, 95 % interval")


def _picture(
    figures: Json, rows: Json, count: str, of: str, draw: Callable[[Axes, Json], None]
) -> str:
    """A row a set, and how much it is made from: model, number of events, simulated or not."""
    kinds = ", ".join(sorted({one["data"]["kind"] for one in figures["sets"].values()}))
    n = sum(row[count] for row in rows.values())
    about = f"{kinds}: {n:,} {of}, model {figures['model']['model_id'][:6]}"
    # readable on a phone, where the picture is 390 px wide
    with drawing(WIDE_IN, 0.5 * len(rows) + 1.7, font_size=12) as figure:
        figure.suptitle(
            about, x=0.995, ha="right", fontsize=10, color=INK, style="italic"
        )
        axes = figure.subplots()
        draw(axes, rows)
        axes.invert_yaxis()
        axes.grid(axis="x", color=GRID)
        axes.set_axisbelow(True)
        if axes.get_legend_handles_labels()[0]:
            figure.legend(
                loc="outside lower center", ncols=3, frameon=False, fontsize=11
            )
        return for_any_page(svg(figure))


PICTURES = {
    "late-or-in-time.svg": late_or_in_time,
    "hand-overs-called.svg": hand_overs_called,
}
