"""Tables of the documentation's pages: chosen columns of a JSON file, written between markers."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any

from holdfast.edge_runtime.command import show
from holdfast.edge_runtime.reading import Json
from holdfast.evaluation.markers import write_between
from holdfast.evaluation.page import markdown

Tables = dict[str, str]
"""Marker's name -> Markdown."""


def refresh(page: str | Path, made_from: Mapping[Path, Callable[[Json], Tables]]) -> None:
    """Write the tables that each JSON file has figures for; those of an absent file stay.

    Raises DataNotFound for a page without the markers.
    """
    for source, tables in made_from.items():
        if source.is_file():
            write_tables(page, tables(json.loads(source.read_text("utf-8"))))
        else:
            show(f"{page}: the tables from {source} stay as they are; that file is not there")


def write_tables(page: str | Path, tables: Mapping[str, str]) -> None:
    """Write each table between the page's markers of its name. Raises DataNotFound without them."""
    for name, table in tables.items():
        write_between(page, name, table.rstrip("\n") + "\n")


def table(rows: Sequence[Mapping[str, Any]], heads: Mapping[str, str]) -> str:
    """The columns of `heads` (key -> title with its unit) as Markdown; "-" where absent."""
    return markdown([{head: row.get(key) for key, head in heads.items()} for row in rows])


def with_interval(value: float | None, interval: Sequence[float] | None) -> str | None:
    """A figure with its 95 % interval: 0.986 (0.98 to 0.99)."""
    if value is None or interval is None:
        return None if value is None else f"{value:.3g}"
    return f"{value:.3g} ({interval[0]:.2f} to {interval[1]:.2f})"
