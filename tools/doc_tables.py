"""Tables of the documentation's pages: chosen columns of a JSON file, written between markers.

Text that a command writes into a page, between `<!-- name: .. -->` and `<!-- /name -->`.
"""

from __future__ import annotations

import json
import re
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from holdfast.cli.command import show
from holdfast.core.errors import DataNotFound
from holdfast.core.reading import Json
from holdfast.core.writing import write_whole
from holdfast.evaluation.page import markdown


def write_between(page: str | Path, name: str, written: str) -> None:
    """Replace the text between a page's markers. Raises DataNotFound without markers."""
    text = Path(page).read_text(encoding="utf-8")
    marked = re.compile(rf"(<!-- {name}:[^\n]*-->\n).*?(<!-- /{name} -->)", re.DOTALL)
    if not marked.search(text):
        raise DataNotFound(
            f"no markers <!-- {name}: --> and <!-- /{name} -->",
            where=page,
            cause="a page written anew, or the wrong page",
            next_step="put both lines where the table belongs",
        )
    write_whole(page, marked.sub(lambda found: found[1] + written + found[2], text))


Tables = dict[str, str]
"""Marker's name -> Markdown."""


def refresh(
    page: str | Path, made_from: Mapping[Path, Callable[[Json], Tables]]
) -> None:
    """Write the tables that each JSON file has figures for; those of an absent file stay.

    Raises DataNotFound for a page without the markers.
    """
    for source, tables in made_from.items():
        if source.is_file():
            write_tables(page, tables(json.loads(source.read_text("utf-8"))))
        else:
            show(
                f"{page}: the tables from {source} stay as they are; that file is not there"
            )


def write_tables(page: str | Path, tables: Mapping[str, str]) -> None:
    """Write each table between the page's markers of its name. Raises DataNotFound without them."""
    for name, table in tables.items():
        write_between(page, name, table.rstrip("\n") + "\n")


def table(rows: Sequence[Mapping[str, Any]], heads: Mapping[str, str]) -> str:
    """The columns of `heads` (key -> title with its unit) as Markdown; "-" where absent."""
    return markdown(
        [{head: row.get(key) for key, head in heads.items()} for row in rows]
    )


def with_interval(value: float | None, interval: Sequence[float] | None) -> str | None:
    """A figure with its 95 % interval: 0.986 (0.98 to 0.99)."""
    if value is None or interval is None:
        return None if value is None else f"{value:.3g}"
    return f"{value:.3g} ({interval[0]:.2f} to {interval[1]:.2f})"
