"""Tables of the documentation's pages: chosen columns of a JSON file, written between markers.

A table stands in a page between `<!-- name: .. -->` and `<!-- /name -->`. A generator is a function
from the content of one JSON file to the tables that it has figures for: marker's name -> rows. A
program that writes tables ends in `main(generator, ..)`, and is called with one JSON file for each
generator, in their order, and the page.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from holdfast.cli.command import show
from holdfast.core.errors import DataNotFound
from holdfast.core.reading import Json
from holdfast.core.writing import write_whole
from holdfast.evaluation.formats import markdown

Rows = Sequence[Mapping[str, Any]]
"""Of a table: title of a column -> cell; every row has the columns of the first."""
Tables = Mapping[str, Rows | str]
"""Marker's name -> the rows of the table, or its Markdown."""
Generator = Callable[[Json], Tables]


def main(*generators: Generator) -> None:
    """Write the tables of the page that the command line names last, from the files before it."""
    *sources, page = map(Path, sys.argv[1:])
    refresh(page, dict(zip(sources, generators, strict=True)))


def refresh(page: str | Path, made_from: Mapping[Path, Generator]) -> None:
    """Write the tables that each JSON file has figures for; those of an absent file stay.

    Raises DataNotFound for a page without the markers.
    """
    for source, generator in made_from.items():
        if source.is_file():
            fill(page, generator(json.loads(source.read_text("utf-8"))))
        else:
            show(
                f"{page}: the tables from {source} stay as they are; that file is not there"
            )


def fill(page: str | Path, tables: Tables) -> None:
    """Write each table between the page's markers of its name. Raises DataNotFound without them."""
    for name, table in tables.items():
        text = table if isinstance(table, str) else markdown(table)
        write_between(page, name, text.rstrip("\n") + "\n")


def write_between(page: str | Path, name: str, text: str) -> None:
    """Replace the text between a page's markers. Raises DataNotFound without markers."""
    whole = Path(page).read_text(encoding="utf-8")
    marked = re.compile(rf"(<!-- {name}:[^\n]*-->\n).*?(<!-- /{name} -->)", re.DOTALL)
    if not marked.search(whole):
        raise DataNotFound(
            f"no markers <!-- {name}: --> and <!-- /{name} -->",
            where=page,
            cause="a page written anew, or the wrong page",
            next_step="put both lines where the table belongs",
        )
    write_whole(page, marked.sub(lambda found: found[1] + text + found[2], whole))


def columns(rows: Rows, heads: Mapping[str, str]) -> list[dict[str, Any]]:
    """Chosen columns of rows of figures. heads: key of a figure -> title with its unit."""
    return [{head: row.get(key) for key, head in heads.items()} for row in rows]


def table(rows: Rows, heads: Mapping[str, str]) -> str:
    """The same as Markdown."""
    return markdown(columns(rows, heads))


def with_interval(value: float | None, interval: Sequence[float] | None) -> str | None:
    """A figure with its 95 % interval: 0.986 (0.98 to 0.99)."""
    if value is None:
        return None
    if interval is None:
        return f"{value:.3g}"
    low, high = interval
    return f"{value:.3g} ({low:.2f} to {high:.2f})"
