"""The front figure: drops saved against hand-overs blocked, each controller a curve."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import matplotlib as mpl
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from evaluation.style import INK, OURS, QUIET, STYLE, svg
from studies.shared_control.plan import CURVE_SETS, SETTINGS

MARKS = {"holdfast": "o", "pd-shear": "s", "smsp": "^", "ismsp": "v"}
Row = dict[str, Any]


def picture(figures: dict[str, Any]) -> str:
    """The SVG: a panel for each set; the lags of the drive as lighter curves of our controller."""
    with mpl.rc_context({**STYLE, "font.size": 11}):
        drawn = Figure(figsize=(10.0, 3.8))
        for place, name in enumerate(CURVE_SETS, 1):
            axes = drawn.add_subplot(1, len(CURVE_SETS), place)
            _panel(axes, [row for row in figures["rows"] if row["set"] == name], name)
            if place == 1:
                axes.set_ylabel("preventable drops saved")
        return svg(drawn)


def _panel(axes: Axes, rows: Sequence[Row], name: str) -> None:
    for which in SETTINGS:
        curve = [r for r in rows if r["part"] == "curve" and r["controller"] == which]
        _curve(axes, curve, which, OURS if which == "holdfast" else QUIET)
    for lag_ms in sorted({row["lag_ms"] for row in rows if row["part"] == "lag"}):
        lagged = [r for r in rows if r["part"] == "lag" and r["lag_ms"] == lag_ms]
        points = _points(lagged)
        axes.plot(*zip(*points, strict=True), "--", color=OURS, alpha=0.45, linewidth=1)
        axes.annotate(f"{lag_ms:g} ms", points[-1], fontsize=8, color=OURS)
    axes.axvline(0.05, color=INK, linewidth=0.6, linestyle=":")
    axes.axhline(0.9, color=INK, linewidth=0.6, linestyle=":")
    axes.set(title=name, xlabel="hand-overs blocked", xlim=(-0.02, 0.6), ylim=(-0.03, 1.05))


def _points(rows: Sequence[Row]) -> list[tuple[float, float]]:
    return [(row["blocked_share"] or 0.0, row["saved_share"] or 0.0) for row in rows]


def _curve(axes: Axes, rows: Sequence[Row], which: str, colour: str) -> None:
    points = _points(rows)
    axes.plot(*zip(*points, strict=True), f"{MARKS[which]}-", color=colour, label=which)
    if points:
        axes.annotate(which, points[-1], (4, 4), textcoords="offset points", fontsize=9)
