"""The picture of the second physics: drops saved by kind, one column of figures beside another."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from holdfast.core.contract import Json
from holdfast.evaluation.style import GRID, OURS, QUIET, drawing, svg
from tools.harness import for_any_page

DROPS = (
    "pull-fast",
    "pull-slow",
    "tug-lost",
    "fall-support",
    "fall-weight",
    "fall-relax",
)
CALLED = ("tug-held", "hand-over", "hand-over-late", "put-down", "pick-up")
HOLDS = ("quiet-hold", "trembling-hold")
PANELS = (
    ("preventable drops saved", DROPS, "saved"),
    ("saved without an earlier tightening", DROPS, "saved_fresh"),
    ("called (should be few)", (*CALLED, *HOLDS), "called"),
)
"""Title, kinds and figure of each panel."""
COLOURS = (QUIET, OURS)


def picture(columns: Sequence[Json]) -> str:
    """The SVG. columns: figures of world.json, the older first; their first tables are drawn."""
    with drawing(10.2, 3.9) as figure:
        panels = figure.subplots(1, len(PANELS))
        for axes, (title, kinds, name) in zip(panels, PANELS, strict=True):
            for place, column in enumerate(columns):
                colour = COLOURS[place - len(columns)]
                _points(axes, column, kinds, name, place / 3.0, colour)
            axes.set_yticks(range(len(kinds)), kinds)
            axes.set_ylim(len(kinds) - 0.5, -0.5)
            axes.set_xlim(-0.02, 1.02)
            axes.set_title(title, fontsize=10, loc="left")
            axes.set_xlabel("share of trials, 95 % interval")
            axes.grid(axis="x", color=GRID)
        if len(columns) > 1:
            # below the panels: beside the points there is no room
            handles, labels = panels[0].get_legend_handles_labels()
            figure.legend(
                handles,
                labels,
                loc="outside lower center",
                ncols=len(labels),
                frameon=False,
                fontsize=8,
            )
        return for_any_page(svg(figure))


def _points(
    axes: Axes,
    column: Json,
    kinds: Sequence[str],
    name: str,
    offset: float,
    colour: str,
) -> None:
    """The shares of one model, with their intervals."""
    rows = {row["kind"]: row for row in column["tables"][0]["kinds"]}
    label = f"model {column.get('label', column['model']['id'])}"
    for place, kind in enumerate(kinds):
        row = rows.get(kind)
        if row is None or row[f"{name}_share"] is None:
            continue
        at = place + offset
        axes.plot(
            row[f"{name}_share_ci"], [at, at], color=colour, linewidth=4, alpha=0.35
        )
        axes.plot(
            row[f"{name}_share"], at, "o", color=colour, markersize=5, label=label
        )
        label = "_again"
