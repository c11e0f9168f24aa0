"""How every picture looks: palettes of situations and fingers, one style, one way to an SVG.

An SVG that a screen reader can name, and that is readable on a light and on a dark page.
"""

from __future__ import annotations

import io
from collections.abc import Iterator
from contextlib import contextmanager
from html import escape
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from matplotlib.axes import Axes
    from matplotlib.figure import Figure


from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from holdfast.core.contract import SITUATIONS, not_learned_in_words
from holdfast.core.errors import count_of
from holdfast.core.writing import write_whole
from holdfast.data.metrics import over
from holdfast.evaluation import formats

# HTML from templates: the one place that knows jinja2. The templates are in templates/.
#
# A page extends `base.html` (its blocks: title, style, body) and imports the macros of
# `parts.html`: a table, a figure, the key of colours, cells with an interval below a value. Numbers
# are written by the functions of `formats.py`, which templates have as filters.
#
# Text is escaped unless it is `Markup` already (a picture as SVG, or what `render` returned). A
# name that a template uses and a caller forgot is an error, never an empty place on a page.

TEMPLATES = Path(__file__).with_name("templates")
FILTERS = {
    "count_of": count_of,
    "number": formats.number,
    "whole": formats.whole,
    "percent": formats.percent,
    "interval": formats.interval,
    "percent_interval": formats.percent_interval,
    "p_value": formats.p_value,
    "spaced": formats.spaced,
    "over": over,
    "not_learned": not_learned_in_words,
    "display_name": formats.display_name,
    "is_this_model": formats.is_this_model,
}


@cache
def _environment(folder: Path) -> Environment:
    """The templates of a folder, which may extend and import those of this package."""
    # StrictUndefined: a forgotten value is an error and no empty place.
    environment = Environment(
        loader=FileSystemLoader([folder, TEMPLATES]),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )
    environment.filters.update(FILTERS)
    # Markup, or the quotes of the CSS would be escaped.
    environment.globals["dark_rules"] = Markup(dark_rules())
    situations = zip(SITUATIONS, SITUATION_COLOURS, strict=True)
    environment.globals["situation_colours"] = dict(situations)
    return environment


def render(name: str, folder: Path = TEMPLATES, **values: object) -> Markup:
    """The template `name` in `folder`, filled in with the values: HTML that needs no escaping."""
    return Markup(_environment(folder).get_template(name).render(values))


def write_page(
    path: Path, name: str, folder: Path = TEMPLATES, **values: object
) -> Path:
    """Write a template that extends `base.html`; OutputError where the page cannot be written.

    The page is one self-contained file. On a phone a picture keeps its size and scrolls; the page
    follows a reader who prefers dark.
    """
    return write_whole(path, str(render(name, folder, **values)))


INK = "#1f2933"
NOTE = "#52606d"
QUIET = "#9aa5b1"
OURS = "#0b69a3"
WARNING = "#cb6e17"
GRID = "#e4e7eb"
SITUATION_COLOURS = ("#bbbbbb", "#56b4e9", "#009e73", "#d55e00")
"""nothing, grasp, safe slip, risky slip: Okabe and Ito's sky blue, bluish green and vermilion,
and a grey."""
DARK_INSTEAD = {
    "#ffffff": "#1e2129",
    "#000000": "#f5f7fa",
    INK: "#e4e7eb",
    NOTE: "#b8c2cc",
    GRID: "#3e4c59",
    OURS: "#5fb0e5",
    "#0072b2": "#4ba3db",
    "#882255": "#b39ddb",
}
"""Ink, paper, grid and dark colours on a dark page; other colours stay."""
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


@contextmanager
def drawing(
    width_in: float, height_in: float, font_size: float = 9
) -> Iterator[Figure]:
    """A figure in the common style, which holds while it is drawn and written."""
    # loaded only where something is drawn
    import matplotlib as mpl
    from matplotlib.figure import Figure

    # drawn and written within it: matplotlib reads some of the style only when it saves
    with mpl.rc_context({**STYLE, "font.size": font_size}):
        yield Figure(figsize=(width_in, height_in))


@contextmanager
def labelled(kind: str, width_in: float, height_in: float) -> Iterator[Figure]:
    """Such a figure with the kind of its data (simulated, recorded) in a corner."""
    with drawing(width_in, height_in) as figure:
        figure.suptitle(
            kind, x=0.995, ha="right", fontsize=8, color=WARNING, style="italic"
        )
        yield figure


def svg(figure: Figure) -> str:
    """The figure as an inline SVG element that names what it shows, the same bytes every time."""
    buffer = io.StringIO()
    # Without a date the bytes depend on the figure alone.
    figure.savefig(buffer, format="svg", metadata={"Date": None})
    text = buffer.getvalue()
    # The XML declaration before it has no place inside a page.
    element = text[text.index("<svg") :]
    # Its own words: kind, titles, axes and the names in its legends.
    panels = [_panel(axes) for axes in figure.axes if axes.get_visible()]
    # Panels that say the same are named once.
    parts = dict.fromkeys([figure.get_suptitle(), *panels])
    return with_label(element, "; ".join(filter(None, parts)).replace("\n", " "))


def _panel(axes: Axes) -> str:
    # Matplotlib keeps a title for each side, and most are empty.
    titles = [axes.get_title(at) for at in ("left", "center", "right")]
    title = " ".join(filter(None, titles))
    labels = (axes.get_ylabel(), axes.get_xlabel())
    against = " against ".join(filter(None, labels))
    _, in_legend = axes.get_legend_handles_labels()
    names = ", ".join(in_legend)
    return ": ".join(filter(None, (title, against, names)))


def with_label(svg: str, label: str) -> str:
    """An SVG element as one image with a name and a title."""
    # Names of sets and files may hold characters that end an attribute.
    name = escape(label)
    start = svg.index("<svg")
    end = svg.index(">", start) + 1
    attributes = svg[start + len("<svg") : end]
    opening = f'<svg role="img" aria-label="{name}"{attributes}'
    return f"{svg[:start]}{opening}<title>{name}</title>{svg[end:]}"


def dark_rules() -> str:
    """CSS that gives drawings their colours of a dark page, where the reader prefers dark."""
    rules = []
    for light, dark in DARK_INSTEAD.items():
        for kind in ("fill", "stroke"):
            # Matplotlib writes colours into style attributes, which only "important" overrides.
            rules.append(f'svg [style*="{kind}: {light}"]{{{kind}:{dark}!important}}')
    return f"@media(prefers-color-scheme:dark){{{''.join(rules)}}}"
