"""Tables of the documentation's pages: those with figures are written, the others stay."""

from __future__ import annotations

import json
from pathlib import Path

import pytest

from holdfast.core.errors import DataNotFound
from tools.doc_tables import refresh

PAGE = """Prose.
<!-- first: written by a command -->
old
<!-- /first -->
<!-- second: written by a command -->
old
<!-- /second -->
"""


def test_a_table_whose_figures_are_not_there_stays_and_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page, there, absent = (
        tmp_path / name for name in ("page.md", "one.json", "two.json")
    )
    page.write_text(PAGE, encoding="utf-8")
    there.write_text(json.dumps({"figure": 7}), encoding="utf-8")
    refresh(
        page,
        {
            there: lambda figures: {"first": f"{figures['figure']}"},
            absent: lambda figures: {"second": f"{figures['figure']}"},
        },
    )
    assert page.read_text("utf-8") == PAGE.replace("old", "7", 1)
    out, err = capsys.readouterr()
    assert f"{absent} stay as they are; that file is not there" in out + err
    with pytest.raises(DataNotFound, match="third"):
        refresh(page, {there: lambda figures: {"third": ""}})
