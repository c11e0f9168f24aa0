"""How every picture looks: palettes of situations and fingers, one style, one way to an SVG."""

from __future__ import annotations

import io
from collections.abc import Sequence
from typing import Any, NamedTuple

from matplotlib.axes import Axes
from matplotlib.figure import Figure

from holdfast.evaluation.drawing import label_of, with_label

INK, QUIET, OURS, WARNING = "#1f2933", "#9aa5b1", "#0b69a3", "#cb6e17"
STYLE: dict[Any, Any] = {
    "font.size": 9,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "axes.edgecolor": QUIET,
    "text.color": INK,
    "axes.labelcolor": INK,
    "xtick.color": INK,
    "ytick.color": INK,
    "svg.fonttype": "none",
    "svg.hashsalt": "holdfast",
    "figure.constrained_layout.use": True,
}
SITUATION_COLOURS = ("#bbbbbb", "#56b4e9", "#009e73", "#d55e00")
"""nothing, grasp, safe slip, risky slip: Okabe and Ito's sky blue, bluish green and vermilion
beside a grey."""
FINGER_COLOURS = ("#000000", "#999933", "#0072b2", "#e69f00", "#cc79a7", "#882255")
FINGER_LINES = ("-", "--", "-", "--", "-", "--")
"""Of thumb 1 and 2, index, middle, ring and little finger: none is a situation's colour, and a line
behind a dashed one still shows."""


def svg(figure: Figure) -> str:
    """The figure as an inline SVG element that names what it shows, the same bytes every time."""
    buffer = io.StringIO()
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    return with_label(text[text.index("<svg") :], label_of(figure))


ROW_COLOURS = {"ours": OURS, "warning": WARNING, "": QUIET}
"""By the class of a row, as the tables of a report have it."""


class Bar(NamedTuple):
    """A figure with its interval. row_class: ours, warning, or nothing."""

    value: float
    interval: Sequence[float]
    row_class: str = ""


def bar(value: float | None, interval: Sequence[float] | None, row_class: str = "") -> Bar:
    """A bar; there is nothing to draw where the figure or its interval is not defined."""
    nothing = float("nan")
    return Bar(nothing if value is None else value, interval or (nothing, nothing), row_class)


def bars(axes: Axes, rows: Sequence[Bar], title: str, start: float) -> None:
    """One figure a row with its interval; this model and warnings in colours of their own."""
    for place, (value, interval, row_class) in enumerate(rows):
        colour = ROW_COLOURS[row_class]
        axes.plot(
            interval, [place, place], color=colour, linewidth=5, alpha=0.35, solid_capstyle="butt"
        )
        axes.plot(value, place, "o", color=colour, markersize=6)
        axes.annotate(
            f"{value:.3f}",
            (value, place),
            (0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    axes.set_xlim(left=start)
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(axis="x", color="#e4e7eb")
    axes.set_axisbelow(True)
