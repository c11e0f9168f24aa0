"""`make docs`: the measured figures of the documentation, from the JSON files in docs/measured.

A table stands in a page between `<!-- name: .. -->` and `<!-- /name -->`; a figure in a sentence
stands between `<!-- name= -->` and `<!-- = -->`. The template of the page, tools/tables/<page>,
writes each table with `{% call put("name") %}` and each figure with `{% call value("name") %}`. It
sees the JSON files of SOURCES by their names, and the functions of tools/table_rows.py. What needs
a file that is not there is not put: the page keeps what it has. Other prose is never touched.

Commands write below build. `make docs KEEP=1` first takes what they left there into docs/measured.
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
EVALUATED = "docs/measured/evaluated.json"
BEFORE = "docs/measured/evaluated-87cf3b64.json"
SOURCES: dict[str, dict[str, str]] = {
    "README.md": {
        "cost": "docs/measured/cost.json",
        "distortions": "docs/measured/distortions-f3e2f3d27698.json",
        "world": "docs/measured/world-f3e2f3d27698.json",
        "latency": "docs/measured/latency-150hz.json",
        "evaluated": EVALUATED,
        "lifts": "docs/measured/people-2026-11-29.json",
    },
    "docs/any-runtime.md": {
        "here": "docs/measured/runtimes.json",
        "arm": "docs/measured/arm.json",
    },
    "docs/faq.md": {"latency": "docs/measured/latency-150hz.json"},
    "docs/for-boards.md": {"arm": "docs/measured/arm.json"},
    "docs/for-clinicians.md": {
        "evaluated": EVALUATED,
        "lifts": "docs/measured/people-2026-11-29.json",
    },
    "docs/hard-cases.md": {
        "distortions": "docs/measured/distortions-f3e2f3d27698.json"
    },
    "docs/how-it-works.md": {},
    "docs/limits.md": {
        "cost": "docs/measured/cost.json",
        "distortions": "docs/measured/distortions-f3e2f3d27698.json",
        "evaluated": EVALUATED,
        "before": BEFORE,
        "closing": "docs/measured/closing-2026-11-29.json",
        "lifts": "docs/measured/people-2026-11-29.json",
        "nested": "docs/measured/nested-choice-2026-11-28.json",
        "real": "docs/measured/people-pinching.json",
    },
    "docs/on-a-hand.md": {"hand": "docs/measured/hand.json"},
    "docs/recording-and-study.md": {"adapt": "docs/measured/adapt-2026-11-28.json"},
    "docs/results.md": {
        "distortions": "docs/measured/distortions-f3e2f3d27698.json",
        "evaluated": EVALUATED,
        "nested": "docs/measured/nested-choice-2026-11-28.json",
        "real": "docs/measured/people-pinching.json",
        "world": "docs/measured/world-f3e2f3d27698.json",
        "openings": "docs/measured/world-openings-e2feeff75e0a.json",
        "before": BEFORE,
        "lifts": "docs/measured/people-2026-11-29.json",
        "cost": "docs/measured/cost.json",
    },
    "docs/scenes.md": {
        "simulator": "docs/measured/simulator.json",
    },
    "docs/shared-control.md": {
        "openings": "docs/measured/world-openings-e2feeff75e0a.json"
    },
    "docs/shared-control-figures.md": {
        "loop": "docs/measured/loop-2026-11-29.json",
        "front": "docs/measured/loop-front-2026-11-29.json",
    },
    "docs/thesis.md": {"preliminary": "docs/measured/preliminary.json"},
    "docs/what-accuracy-costs.md": {
        "cost": "docs/measured/cost.json",
        "on_hands": "docs/measured/robust-2026-11-25.json",
        "latency": "docs/measured/latency-150hz.json",
    },
}
"""Page -> the files that its template sees."""
WRITTEN = {
    "build/bench/runtimes.json": "docs/measured/runtimes.json",
    "build/bench/arm.json": "docs/measured/arm.json",
    "build/bench/hand.json": "docs/measured/hand.json",
    "build/bench/simulator.json": "docs/measured/simulator.json",
    "build/evaluate/figures.json": EVALUATED,
    "build/real/metrics.json": "docs/measured/people-pinching.json",
    "build/preliminary/preliminary.json": "docs/measured/preliminary.json",
}
"""What a command writes -> where it is kept."""
VALUE = re.compile(r"(<!-- ([\w-]+)= -->)(.*?)(<!-- = -->)", re.DOTALL)
"""A figure in a sentence: opening mark, name, text, closing mark."""


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


def figures_of(
    page: str, figures: Mapping[str, Json]
) -> tuple[dict[str, str], dict[str, str]]:
    """The tables of a page, and the figures of its sentences: name of the mark -> Markdown.

    figures: by the names of SOURCES.
    """
    tables: dict[str, str] = {}
    values: dict[str, str] = {}

    def put(name: str, caller: Callable[[], str]) -> str:
        # a run that left rows out writes an empty table, which is not put
        if text := _called(caller).strip("\n"):
            tables[name] = text + "\n"
        return ""

    def value(name: str, caller: Callable[[], str]) -> str:
        if text := _called(caller).strip():
            values[name] = text
        return ""

    absent = {name: _Absent() for name in SOURCES[page]}
    _template(page).render({**absent, **figures, "put": put, "value": value})
    return tables, values


def _called(caller: Callable[[], str]) -> str:
    """What a block of a template writes; nothing where its figures are not there."""
    try:
        return caller()
    except _NotThere:
        return ""


def tables_of(page: str, figures: Mapping[str, Json]) -> dict[str, str]:
    """The tables of a page alone."""
    return figures_of(page, figures)[0]


def fill(
    page: str | Path, tables: Mapping[str, str], values: Mapping[str, str] | None = None
) -> None:
    """Write each table and each figure between the page's marks of its name.

    A figure that is not among the values stays. Raises DataNotFound for a table without marks.
    """
    for name, text in tables.items():
        write_between(page, name, text)
    if values:
        whole = Path(page).read_text(encoding="utf-8")
        written = VALUE.sub(
            lambda found: found[1] + values.get(found[2], found[3]) + found[4], whole
        )
        write_whole(page, written)


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


def read_figures(page: str) -> dict[str, Json]:
    """The figures of a page, by the names of SOURCES; names the files that are not there."""
    figures: dict[str, Json] = {}
    for name, place in SOURCES[page].items():
        if Path(place).is_file():
            figures[name] = json.loads(Path(place).read_text("utf-8"))
        else:
            show(f"{page}: the figures of {place} stay: that file is not there")
    return figures


def refresh(page: str) -> None:
    """Write the figures whose files are there into a page."""
    fill(page, *figures_of(page, read_figures(page)))


def keep() -> None:
    """Take what commands left below build into docs/measured."""
    for made, kept in WRITTEN.items():
        if Path(made).is_file():
            show(f"{made} is kept as {kept}")
            write_whole(kept, Path(made).read_text("utf-8"))


if __name__ == "__main__":
    pages = [word for word in sys.argv[1:] if word != "--keep"]
    if "--keep" in sys.argv:
        keep()
    for each in pages or SOURCES:
        refresh(each)
