"""Tables of a page of the repository, written into a copy of it."""

from __future__ import annotations

import re
from collections.abc import Mapping
from pathlib import Path

from holdfast.core.contract import Json
from tools.doc_tables import VALUE, figures_of, fill

ROOT = Path(__file__).resolve().parents[2]
BETWEEN = re.compile(r"(<!-- ([\w-]+):[^\n]*-->\n)(.*?)(<!-- /\2 -->)", re.DOTALL)


def filled(page: str, figures: Mapping[str, Json], folder: Path) -> str:
    """The page with the tables of these figures, which are named as in tools/doc_tables.py.

    Writing twice changes nothing, prose stays, and the columns are those of the page.
    """
    tables, values = figures_of(page, figures)
    assert tables
    before = (ROOT / page).read_text("utf-8")
    copy = folder / Path(page).name
    copy.write_text(before, encoding="utf-8")
    fill(copy, tables, values)
    once = copy.read_text("utf-8")
    fill(copy, tables, values)
    assert copy.read_text("utf-8") == once
    assert _prose(once) == _prose(before)
    assert set(tables) <= set(_heads(before))
    assert _heads(once) == _heads(before)
    return once


def _prose(page: str) -> str:
    return VALUE.sub(r"\1\4", BETWEEN.sub(r"\1\4", page))


def _heads(page: str) -> dict[str, str]:
    """Marker's name -> the head of its table."""
    return {found[2]: found[3].partition("\n")[0] for found in BETWEEN.finditer(page)}
