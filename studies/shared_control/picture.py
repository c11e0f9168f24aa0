"""The front figure: drops saved against hand-overs blocked, each controller a curve."""

from __future__ import annotations

from collections.abc import Sequence

from matplotlib.axes import Axes

from holdfast.core.contract import Json
from holdfast.evaluation.style import INK, OURS, QUIET, drawing, svg
from studies.shared_control.plan import CURVE_SETS, LAG_MS, LAGS_MS, SETTINGS

MARKS = {"holdfast": "o", "pd-shear": "s", "smsp": "^", "ismsp": "v"}
BLOCKED_AIM = 0.05
SAVED_AIM = 0.9
Row = Json


def picture(figures: Json) -> str:
    """The SVG: a panel for each lag of the drive; the sets of the curves are counted together."""
    rows = [
        r
        for r in figures["rows"]
        if r["part"] in ("curve", "lag") and r["set"] in CURVE_SETS
    ]
    with drawing(10.0, 3.8, font_size=11) as drawn:
        lags = sorted({LAG_MS, *LAGS_MS})
        for place, lag_ms in enumerate(lags, 1):
            axes = drawn.add_subplot(1, len(lags), place)
            _panel(axes, [row for row in rows if row["lag_ms"] == lag_ms], lag_ms)
            if place == 1:
                axes.set_ylabel("preventable drops saved")
        return svg(drawn)


def _panel(axes: Axes, rows: Sequence[Row], lag_ms: float) -> None:
    for which in SETTINGS:
        points = curve([row for row in rows if row["controller"] == which])
        colour = OURS if which == "holdfast" else QUIET
        axes.plot(
            *zip(*points, strict=True), f"{MARKS[which]}-", color=colour, label=which
        )
        axes.annotate(which, points[-1], (4, 4), textcoords="offset points", fontsize=9)
    axes.axvline(BLOCKED_AIM, color=INK, linewidth=0.6, linestyle=":")
    axes.axhline(SAVED_AIM, color=INK, linewidth=0.6, linestyle=":")
    title = f"drive with a lag of {lag_ms:g} ms"
    axes.set(
        title=title, xlabel="hand-overs blocked", xlim=(-0.02, 0.6), ylim=(-0.03, 1.05)
    )


def curve(rows: Sequence[Row]) -> list[tuple[float, float]]:
    """(hand-overs blocked, drops saved) for each setting, of all sets together."""
    settings = sorted({row["setting"] for row in rows})
    each = [[row for row in rows if row["setting"] == setting] for setting in settings]
    return [
        (_share(one, "blocked", "handovers"), _share(one, "saved", "preventable"))
        for one in each
    ]


def _share(rows: Sequence[Row], part: str, whole: str) -> float:
    return sum(row[part] for row in rows) / max(1, sum(row[whole] for row in rows))
