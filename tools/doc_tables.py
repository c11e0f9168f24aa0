"""`make docs`: the tables of the documentation, from the JSON files that commands wrote.

A table stands in a page between `<!-- name: .. -->` and `<!-- /name -->`. The template of the page,
tools/tables/<page>, writes each with `{% call put("name") %}`. It sees the JSON files of SOURCES by
their names, and the functions of tools/table_rows.py. A table whose file is not there is not put:
the one in the page stays. Prose is never touched.
"""

from __future__ import annotations

import json
import re
import sys
from collections.abc import Callable, Mapping
from functools import cache
from pathlib import Path
from typing import NoReturn

from jinja2 import Environment, FileSystemLoader, StrictUndefined, Template

from holdfast.cli.command import show
from holdfast.core.contract import Json
from holdfast.core.errors import DataNotFound
from holdfast.core.writing import write_whole
from holdfast.evaluation.formats import markdown_cell
from tools import table_rows

TEMPLATES = Path(__file__).with_name("tables")
SOURCES: dict[str, dict[str, str]] = {
    "README.md": {
        "cost": "docs/measured/cost.json",
        "distortions": "docs/measured/distortions-080828f74eb1.json",
        "wide": "docs/measured/wide-080828f74eb1.json",
        "loop": "docs/measured/loop-2026-11-28.json",
        "world": "docs/measured/world-e2feeff75e0a.json",
        "latency": "docs/measured/latency-150hz.json",
        "evaluated": "build/evaluate/figures.json",
        "lifts": "docs/measured/people-2026-11-28.json",
    },
    "docs/any-runtime.md": {
        "here": "build/bench/runtimes.json",
        "arm": "build/bench/arm.json",
    },
    "docs/hard-cases.md": {
        "distortions": "docs/measured/distortions-080828f74eb1.json"
    },
    "docs/how-it-works.md": {},
    "docs/on-a-hand.md": {"hand": "build/bench/hand.json"},
    "docs/recording-and-study.md": {"adapt": "docs/measured/adapt-2026-11-28.json"},
    "docs/results.md": {
        "distortions": "docs/measured/distortions-080828f74eb1.json",
        "evaluated": "build/evaluate/figures.json",
        "nested": "docs/measured/nested-choice-2026-11-28.json",
        "real": "build/real/metrics.json",
        "world": "docs/measured/world-e2feeff75e0a.json",
        "openings": "docs/measured/world-openings-e2feeff75e0a.json",
        "wide": "docs/measured/wide-080828f74eb1.json",
        "lifts": "docs/measured/people-2026-11-28.json",
    },
    "docs/scenes.md": {
        "simulator": "build/bench/simulator.json",
    },
    "docs/shared-control.md": {
        "loop": "docs/measured/loop-2026-11-28.json",
        "front": "docs/measured/loop-front-2026-11-28.json",
    },
    "docs/thesis.md": {"preliminary": "build/preliminary/preliminary.json"},
    "docs/what-accuracy-costs.md": {
        "cost": "docs/measured/cost.json",
        "on_hands": "docs/measured/robust-2026-11-25.json",
        "latency": "docs/measured/latency-150hz.json",
    },
}
"""Page -> the files that its template sees."""


class _NotThere(Exception):
    """A table needs figures of a file that does not exist."""


class _Absent:
    """Stands for the figures of a file that is not there: any use of them ends the table."""

    def __getattr__(self, key: str) -> NoReturn:
        raise _NotThere

    def __getitem__(self, key: object) -> NoReturn:
        raise _NotThere


@cache
def _template(page: str) -> Template:
    environment = Environment(
        loader=FileSystemLoader(TEMPLATES),
        undefined=StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
        finalize=markdown_cell,
    )
    environment.filters["cell"] = markdown_cell
    environment.globals.update(table_rows.FUNCTIONS)
    return environment.get_template(Path(page).name)


def tables_of(page: str, figures: Mapping[str, Json]) -> dict[str, str]:
    """The tables of a page: marker's name -> Markdown. figures: by the names of SOURCES."""
    tables: dict[str, str] = {}

    def put(name: str, caller: Callable[[], str]) -> str:
        try:
            text = caller().strip("\n")
        except _NotThere:
            return ""
        # a run that left rows out writes an empty table, which is not put
        if text:
            tables[name] = text + "\n"
        return ""

    absent = {name: _Absent() for name in SOURCES[page]}
    _template(page).render({**absent, **figures, "put": put})
    return tables


def fill(page: str | Path, tables: Mapping[str, str]) -> None:
    """Write each table between the page's markers of its name. Raises DataNotFound without them."""
    for name, text in tables.items():
        write_between(page, name, text)


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


def refresh(page: str) -> None:
    """Write the tables whose files are there into a page; name the files that are not."""
    figures: dict[str, Json] = {}
    for name, place in SOURCES[page].items():
        if Path(place).is_file():
            figures[name] = json.loads(Path(place).read_text("utf-8"))
        else:
            show(f"{page}: the tables of {place} stay: that file is not there")
    fill(page, tables_of(page, figures))


if __name__ == "__main__":
    for each in sys.argv[1:] or SOURCES:
        refresh(each)
