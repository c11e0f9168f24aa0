"""Two pictures of docs/evaluation.md, late or in time and hand-overs called: `make docs`."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from holdfast.core.reading import Json
from holdfast.evaluation.formats import DEPLOYED
from holdfast.evaluation.style import INK, OURS, STYLE, WARNING, for_any_page, svg

LARGE: dict[Any, Any] = {**STYLE, "font.size": 12}
"""Readable on a phone: the pictures are 390 px wide there."""
WIDE_IN = 5.6


def late_or_in_time(figures: Json) -> str:
    """Of each set's risky events: acted on before gross slip, later, or not at all."""
    rows = {name: one["rows"][DEPLOYED] for name, one in figures["sets"].items()}
    rows = {name: row for name, row in rows.items() if row["events"]}
    with mpl.rc_context(LARGE):
        figure, axes = _figure(figures, rows, "events", "risky events")
        left = dict.fromkeys(rows, 0.0)
        for name, colour, share in PARTS:
            width = [share(row) for row in rows.values()]
            axes.barh(
                list(rows), width, 0.62, list(left.values()), color=colour, label=name
            )
            left = {
                key: at + part
                for (key, at), part in zip(left.items(), width, strict=True)
            }
        axes.set_xlabel("share of risky events")
        _finish(figure, axes)
        return for_any_page(svg(figure))


def _in_time(row: Json) -> float:
    return float(row["in_time"])


def _late(row: Json) -> float:
    return float(row["recall"] - row["in_time"])


def _missed(row: Json) -> float:
    return float(1.0 - row["recall"])


PARTS: tuple[tuple[str, str, Callable[[Json], float]], ...] = (
    ("before gross slip", OURS, _in_time),
    ("late", WARNING, _late),
    ("not at all", "#bbbbbb", _missed),
)


def hand_overs_called(figures: Json) -> str:
    """Of each set's voluntary actions: the share with an alarm, and its 95 % interval."""
    rows = {
        name: one["rows"][DEPLOYED]["safe_acts_called"]
        for name, one in figures["sets"].items()
    }
    rows = {name: row for name, row in rows.items() if row and row["n"]}
    with mpl.rc_context(LARGE):
        figure, axes = _figure(figures, rows, "n", "voluntary actions")
        for place, row in enumerate(rows.values()):
            axes.plot(
                row["share_ci"], [place, place], color=WARNING, linewidth=7, alpha=0.4
            )
            axes.plot(row["share"], place, "o", color=INK, markersize=7)
        axes.set_yticks(range(len(rows)), list(rows))
        axes.set_xlim(left=0.0)
        axes.set_xlabel("share called risky, 95 % interval")
        _finish(figure, axes)
        return for_any_page(svg(figure))


def _figure(figures: Json, rows: Json, count: str, of: str) -> tuple[Figure, Axes]:
    """A figure that says how much it is made from: model, number of events, simulated or not."""
    kinds = ", ".join(sorted({one["data"]["kind"] for one in figures["sets"].values()}))
    n = sum(row[count] for row in rows.values())
    figure = Figure(figsize=(WIDE_IN, 0.5 * len(rows) + 1.7))
    about = f"{kinds}: {n:,} {of}, model {figures['model']['model_id'][:6]}"
    figure.suptitle(about, x=0.995, ha="right", fontsize=10, color=INK, style="italic")
    return figure, figure.subplots()


def _finish(figure: Figure, axes: Axes) -> None:
    axes.invert_yaxis()
    axes.grid(axis="x", color="#e4e7eb")
    axes.set_axisbelow(True)
    if axes.get_legend_handles_labels()[0]:
        figure.legend(loc="outside lower center", ncols=3, frameon=False, fontsize=11)


PICTURES = {
    "late-or-in-time.svg": late_or_in_time,
    "hand-overs-called.svg": hand_overs_called,
}
