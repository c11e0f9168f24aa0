"""Tables of a page of the repository, written into a copy of it."""

from __future__ import annotations

import re
from collections.abc import Iterable
from pathlib import Path

from holdfast.core.reading import Json
from tools.doc_tables import Generator, Rows, Tables, fill

ROOT = Path(__file__).resolve().parents[2]
BETWEEN = re.compile(r"(<!-- ([\w-]+):[^\n]*-->\n)(.*?)(<!-- /\2 -->)", re.DOTALL)


def tables_of(made_from: Iterable[Generator], *figures: Json) -> Tables:
    """All tables of a page, from the figures of each command."""
    made: dict[str, Rows | str] = {}
    for tables, one in zip(made_from, figures, strict=True):
        made |= tables(one)
    return made


def require_tables_fit(page: str, tables: Tables, folder: Path) -> str:
    """The page with these tables. Writing twice changes nothing, prose stays, columns agree."""
    before = (ROOT / page).read_text("utf-8")
    copy = folder / Path(page).name
    copy.write_text(before, encoding="utf-8")
    fill(copy, tables)
    once = copy.read_text("utf-8")
    fill(copy, tables)
    assert copy.read_text("utf-8") == once
    assert BETWEEN.sub(r"\1\4", once) == BETWEEN.sub(r"\1\4", before)
    assert set(tables) <= set(_heads(before))
    assert _heads(once) == _heads(before)
    return once


def _heads(page: str) -> dict[str, str]:
    """Marker's name -> the head of its table."""
    return {found[2]: found[3].partition("\n")[0] for found in BETWEEN.finditer(page)}
