"""HTML from templates: the one place that knows jinja2. The templates are in templates/.

Text is escaped unless it is `Markup` already (a picture as SVG, or what `render` returned). A name
that a template uses and a caller forgot is an error, never an empty place on a page.
"""

from __future__ import annotations

from functools import cache
from pathlib import Path

from jinja2 import Environment, FileSystemLoader, StrictUndefined
from markupsafe import Markup

TEMPLATES = Path(__file__).with_name("templates")


@cache
def _environment(folder: Path) -> Environment:
    return Environment(
        loader=FileSystemLoader(folder),
        autoescape=True,
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        keep_trailing_newline=True,
    )


def render(name: str, folder: Path = TEMPLATES, **values: object) -> Markup:
    """The template `name` in `folder`, filled in with the values: HTML that needs no escaping."""
    return Markup(_environment(folder).get_template(name).render(values))
