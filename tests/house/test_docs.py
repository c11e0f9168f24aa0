"""The documents: links lead to files, every page is in the site, every picture has a name."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
PICTURES = sorted((ROOT / "docs").glob("*.svg"))
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.py"))
SITE = (ROOT / "tools/docs_site/mkdocs.yml").read_text("utf-8")
TO_PRINT = "tags.svg"
SVG = "{http://www.w3.org/2000/svg}"


@pytest.mark.parametrize("page", [*PAGES, *NOTEBOOKS], ids=lambda page: page.name)
def test_every_path_a_page_points_to_exists(page: Path) -> None:
    links = re.findall(r"\]\((?!\w+:)([^)#\s]+)", page.read_text("utf-8"))
    missing = [link for link in links if not (page.parent / link).exists()]
    assert [
        link for link in missing if not (page.parent / link).with_suffix(".py").exists()
    ] == []


def test_every_page_and_every_notebook_is_in_the_site() -> None:
    named = set(re.findall(r": (\S+\.md)$", SITE, re.MULTILINE))
    pages = {page.name for page in PAGES}
    notebooks = {f"notebooks/{book.stem}.md" for book in NOTEBOOKS}
    assert len(notebooks) >= 2
    assert named == pages | notebooks | {
        "index.md",
        "source/CHANGELOG.md",
        "source/CONTRIBUTING.md",
    }


@pytest.mark.parametrize("picture", PICTURES, ids=lambda picture: picture.name)
def test_every_picture_says_what_it_shows(picture: Path) -> None:
    drawn = ET.parse(picture).getroot()
    title = drawn.find(f"{SVG}title")
    assert drawn.get("role") == "img"
    assert len(drawn.get("aria-label", "")) > 30
    assert title is not None
    assert title.text == drawn.get("aria-label")


@pytest.mark.parametrize("picture", PICTURES, ids=lambda picture: picture.name)
def test_every_picture_that_is_not_printed_follows_a_dark_page(picture: Path) -> None:
    follows = "prefers-color-scheme:dark" in picture.read_text("utf-8")
    assert follows == (picture.name != TO_PRINT)


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *PAGES], ids=lambda page: page.name
)
def test_every_picture_in_a_page_has_words_in_its_place(page: Path) -> None:
    words = re.findall(r"!\[([^\]]*)\]\(", page.read_text("utf-8"))
    assert all(len(one) > 15 for one in words), words
