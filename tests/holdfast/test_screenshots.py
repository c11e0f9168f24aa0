"""`make screenshots`: pictures at every width, light and dark, and what is cut off by name."""

from __future__ import annotations

from pathlib import Path

import pytest
from headless_browser import needs_chromium

from tools import screenshots

HEAD = '<!doctype html><meta name="viewport" content="width=device-width">'
DARK = "<style>@media (prefers-color-scheme: dark) {body {background: black}}</style>"
WIDE = '<table style="width: 90rem"><tr><td>{name}</td></tr></table>'


def test_a_page_that_is_not_there_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(screenshots, "CHROMIUM", "/usr/bin/chromium")
    assert screenshots.main([str(tmp_path / "absent.html")]) == 2
    assert "absent.html: make docs-site first" in capsys.readouterr().err


def test_without_chromium_it_says_so(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(screenshots, "CHROMIUM", None)
    page = tmp_path / "page.html"
    page.write_text("<p>text")
    assert screenshots.main([str(page)]) == 2
    assert "chromium is not installed" in capsys.readouterr().err


@needs_chromium
def test_what_is_wider_than_the_window_is_cut_off_unless_its_box_scrolls(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    page = tmp_path / "page.html"
    scrolls = f'<div style="overflow-x: auto">{WIDE.format(name="scrolls")}</div>'
    hidden = f'<div style="overflow: hidden">{WIDE.format(name="hidden")}</div>'
    page.write_text(f"{HEAD}{DARK}{scrolls}{hidden}")
    out = tmp_path / "out"
    assert screenshots.main([str(page), "--out", str(out)]) == 1
    printed = capsys.readouterr().out
    assert "at 390 px: cut off: table hidden" in printed
    assert "at 1366 px: cut off: table hidden" in printed
    assert "1920" not in printed, "90rem fit"
    assert "scrolls" not in printed
    assert len(list(out.glob("*.png"))) == 6


@needs_chromium
def test_a_page_that_is_the_same_in_the_dark_is_named(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    follows, keeps = tmp_path / "follows.html", tmp_path / "keeps.html"
    follows.write_text(f"{HEAD}{DARK}<p>text")
    keeps.write_text(f"{HEAD}<p>text")
    words = [str(follows), str(keeps), "--out", str(tmp_path / "out")]
    assert screenshots.main(words) == 1
    printed = capsys.readouterr().out
    assert printed.count("keeps.html at") == 3
    assert "follows.html" not in printed
