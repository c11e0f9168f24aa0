"""The picture: a row a distortion; recall, voluntary actions called and drops saved as dots."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from holdfast.core.contract import Json
from holdfast.evaluation.style import GRID, INK, OURS, QUIET, drawing, svg

PANELS = {
    "found": "slips found (recall)",
    "called": "voluntary actions called",
    "saved_share": "preventable drops saved",
}
"""Key of a row -> title of its panel."""
ROW_IN = 0.2
"""Height of a row, inches."""


def picture(figures: Json, before: Json) -> str:
    """The SVG; dots of the model before are grey where it is another one."""
    rows = figures["rows"]
    older = {row["name"]: row for row in before["rows"]}
    shows_older = before["model"] != figures["model"]
    with drawing(10.2, ROW_IN * len(rows) + 1.0) as drawn:
        panels = drawn.subplots(1, len(PANELS), sharey=True)
        for axes, (key, title) in zip(panels, PANELS.items(), strict=True):
            if shows_older:
                there = [older.get(row["name"]) for row in rows]
                _dots(axes, there, key, QUIET, f"before: {before['model']}")
            _dots(axes, rows, key, OURS, f"model {figures['model']}")
            if key == "saved_share":
                _untightened(axes, rows)
            _bound(axes, rows[0][key])
            axes.set_title(title, fontsize=10, loc="left")
        first = panels[0]
        first.set_yticks(range(len(rows)), [row["words"] for row in rows], fontsize=8)
        first.set_ylim(len(rows) - 0.4, -0.6)
        if shows_older:
            first.legend(frameon=False, fontsize=8, loc="lower left")
        return svg(drawn)


def _dots(
    axes: Axes, rows: Sequence[Json | None], key: str, colour: str, label: str
) -> None:
    """A dot with its interval a row; nothing where the row has no such figure."""
    for place, row in enumerate(rows):
        if row is None or row[key] is None:
            continue
        axes.plot(
            row[f"{key}_ci"],
            [place, place],
            color=colour,
            linewidth=4,
            alpha=0.35,
            solid_capstyle="butt",
        )
        # One entry in the legend for all dots of a model.
        name = label if place == 0 else None
        axes.plot(row[key], place, "o", color=colour, markersize=4.5, label=name)


def _untightened(axes: Axes, rows: Sequence[Json]) -> None:
    """An open diamond: drops saved in holds without an earlier tightening."""
    for place, row in enumerate(rows):
        counted = row["saved_untightened"]
        if counted and counted["of"]:
            axes.plot(
                counted["share"], place, "D", color=INK, fillstyle="none", markersize=6
            )


def _bound(axes: Axes, unchanged: float | None) -> None:
    """A line through the unchanged set."""
    axes.set_xlim(-0.03, 1.03)
    axes.grid(axis="both", color=GRID, linewidth=0.6)
    axes.set_axisbelow(True)
    axes.tick_params(axis="y", length=0)
    if unchanged is not None:
        axes.axvline(unchanged, color=INK, linewidth=0.7, linestyle=":")
