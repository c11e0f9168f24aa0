"""Tables of the documentation's pages: those with figures are written, the others stay."""

from __future__ import annotations

import json
from pathlib import Path

import pytest
from jinja2 import UndefinedError

from holdfast.core.errors import DataNotFound
from tools import doc_tables

PAGE = """Prose.
<!-- first: written by a command -->
old
<!-- /first -->
<!-- second: written by a command -->
old
<!-- /second -->
"""
TEMPLATE = """{% call put("first") %}{{ one.figure }}{% endcall %}
{% call put("second") %}{{ two.figure }}{% endcall %}
"""


@pytest.fixture
def page(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """A page whose template needs two files; only one of them is there."""
    page = tmp_path / "page.md"
    page.write_text(PAGE, "utf-8")
    (tmp_path / "templates").mkdir()
    (tmp_path / "templates/page.md").write_text(TEMPLATE, "utf-8")
    (tmp_path / "one.json").write_text(json.dumps({"figure": 7}), "utf-8")
    files = {name: str(tmp_path / f"{name}.json") for name in ("one", "two")}
    monkeypatch.setattr(doc_tables, "TEMPLATES", tmp_path / "templates")
    monkeypatch.setitem(doc_tables.SOURCES, str(page), files)
    return page


def test_a_table_whose_figures_are_not_there_stays_and_is_named(
    page: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    doc_tables.refresh(str(page))
    assert page.read_text("utf-8") == PAGE.replace("old", "7", 1)
    assert "two.json stay: that file is not there" in capsys.readouterr().out


def test_a_figure_that_is_missing_from_its_file_is_an_error(page: Path) -> None:
    (page.parent / "two.json").write_text("{}", "utf-8")
    with pytest.raises(UndefinedError, match="figure"):
        doc_tables.refresh(str(page))


def test_a_table_without_a_place_in_the_page_is_an_error(page: Path) -> None:
    with pytest.raises(DataNotFound, match="third"):
        doc_tables.fill(page, {"third": ""})
