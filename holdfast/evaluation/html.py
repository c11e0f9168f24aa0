"""HTML from templates: the one place that knows jinja2. The templates are in templates/.

A page extends `base.html` (its blocks: title, style, body) and imports the macros of `parts.html`:
a table, a figure, the key of colours, cells with an interval below a value. Numbers are written by
the functions of `formats.py`, which templates have as filters.

Text is escaped unless it is `Markup` already (a picture as SVG, or what `render` returned). A name
that a template uses and a caller forgot is an error, never an empty place on a page.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

from holdfast.core.contract import SITUATIONS, not_learned_in_words
from holdfast.core.errors import count_of
from holdfast.core.writing import write_whole
from holdfast.evaluation import formats
from holdfast.evaluation.style import SITUATION_COLOURS, dark_rules
from holdfast.training.figures import over

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
