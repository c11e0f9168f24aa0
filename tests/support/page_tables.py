"""Tables of a page of the repository, written into a copy of it."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterable, Mapping
from pathlib import Path

from holdfast.core.reading import Json
from tools.doc_tables import Tables, write_tables

ROOT = Path(__file__).resolve().parents[2]
BETWEEN = re.compile(r"(<!-- ([\w-]+):[^\n]*-->\n)(.*?)(<!-- /\2 -->)", re.DOTALL)


def tables_of(made_from: Iterable[Callable[[Json], Tables]], *figures: Json) -> Tables:
    """All tables of a page, from the figures of each command."""
    made: Tables = {}
    for tables, one in zip(made_from, figures, strict=True):
        made |= tables(one)
    return made


def require_tables_fit(page: str, tables: Mapping[str, str], folder: Path) -> str:
    """The page with these tables. Writing twice changes nothing, prose stays, columns agree."""
    before = (ROOT / page).read_text("utf-8")
    copy = folder / Path(page).name
    copy.write_text(before, encoding="utf-8")
    write_tables(copy, tables)
    once = copy.read_text("utf-8")
    write_tables(copy, tables)
    assert copy.read_text("utf-8") == once
    assert BETWEEN.sub(r"\1\4", once) == BETWEEN.sub(r"\1\4", before)
    shown = {
        match[2]: match[3].partition("\n")[0] for match in BETWEEN.finditer(before)
    }
    written = {name: table.partition("\n")[0] for name, table in tables.items()}
    assert {name: shown[name] for name in written} == written
    return once
