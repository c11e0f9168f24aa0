"""An SVG that a screen reader can name, and that is readable on a light and on a dark page."""

from __future__ import annotations

from html import escape
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure

DARK_INSTEAD = {
    "#ffffff": "#1e2129",
    "#000000": "#f5f7fa",
    "#1f2933": "#e4e7eb",
    "#52606d": "#b8c2cc",
    "#e4e7eb": "#3e4c59",
    "#0b69a3": "#5fb0e5",
    "#0072b2": "#4ba3db",
    "#882255": "#b39ddb",
}
"""Ink, paper, grid and dark colours on a dark page; other colours stay."""


def label_of(figure: Figure) -> str:
    """What a figure shows, from its own words: kind, titles, axes and the names in its legends."""
    shown = [axes for axes in figure.axes if axes.get_visible()]
    panels = dict.fromkeys(filter(None, map(_panel, shown)))
    return "; ".join(filter(None, [figure.get_suptitle(), *panels])).replace("\n", " ")


def _panel(axes: Axes) -> str:
    titles = " ".join(filter(None, (axes.get_title(at) for at in ("left", "center", "right"))))
    against = " against ".join(filter(None, (axes.get_ylabel(), axes.get_xlabel())))
    names = ", ".join(axes.get_legend_handles_labels()[1])
    return ": ".join(filter(None, (titles, against, names)))


def with_label(svg: str, label: str) -> str:
    """An SVG element as one image with a name and a title."""
    start = svg.index("<svg")
    head = f'<svg role="img" aria-label="{escape(label)}"'
    end = svg.index(">", start) + 1
    rest = svg[start + len("<svg") : end]
    return f"{svg[:start]}{head}{rest}<title>{escape(label)}</title>{svg[end:]}"


def dark_rules() -> str:
    """CSS that gives drawings their colours of a dark page, where the reader prefers dark."""
    rules = "".join(
        f'svg [style*="{kind}: {light}"]{{{kind}:{dark}!important}}'
        for light, dark in DARK_INSTEAD.items()
        for kind in ("fill", "stroke")
    )
    return f"@media(prefers-color-scheme:dark){{{rules}}}"


def for_any_page(svg: str) -> str:
    """A file of its own: with other ink and paper where the reader prefers dark."""
    end = svg.index(">", svg.index("<svg")) + 1
    return f"{svg[:end]}<style>{dark_rules()}</style>{svg[end:]}"
