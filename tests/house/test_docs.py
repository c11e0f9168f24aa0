"""The documents: links lead to files, every page is in the site, every picture has a name."""

from __future__ import annotations

import json
import re
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[2]
PAGES = sorted((ROOT / "docs").glob("*.md"))
NOTEBOOKS = sorted((ROOT / "docs/notebooks").glob("*.py"))
SITE = (ROOT / "tools/docs_site/mkdocs.yml").read_text("utf-8")


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *PAGES, *NOTEBOOKS], ids=lambda page: page.name
)
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


PROSE = 38_000
"""Words of README and pages, without the tables that are generated and without code."""
GENERATED = re.compile(r"<!-- ([\w-]+):[^\n]*-->\n.*?<!-- /\1 -->", re.DOTALL)


def words(page: Path) -> int:
    """Words of a page, without generated tables and marks."""
    text = GENERATED.sub("", page.read_text("utf-8"))
    return len(re.sub(r"<!--.*?-->", "", text, flags=re.DOTALL).split())


def test_documents_stay_short_enough_to_be_read() -> None:
    readme = ROOT / "README.md"
    assert len(readme.read_text("utf-8").splitlines()) <= 100
    assert len(PAGES) <= 26
    assert sum(map(words, [readme, *PAGES])) <= PROSE
    assert words(ROOT / "docs/decisions.md") <= 3_500
    assert words(ROOT / "docs/shared-control.md") <= 1_500


def test_the_page_lists_each_rule_of_a_card_with_the_shipped_value() -> None:
    page = (ROOT / "docs/how-it-works.md").read_text("utf-8")
    page = page.partition("## Decision")[2].partition("## Grip and")[0]
    listed: dict[str, int] = {}
    for names, values in re.findall(
        r"^\| (`\w+`[^|]*) \| ([\d, ]+) \|", page, re.MULTILINE
    ):
        pairs = zip(re.findall(r"`(\w+)`", names), values.split(","), strict=True)
        listed |= {name: int(value) for name, value in pairs}
    card = json.loads((ROOT / "models/holdfast-150hz.json").read_text("utf-8"))
    assert listed == card["decision"]


def test_an_error_is_found_by_the_text_that_the_software_prints() -> None:
    page = (ROOT / "docs/cheat-sheet.md").read_text("utf-8").partition("## Errors")[2]
    rows = re.findall(r"^\| (`.*?) \|", page, re.MULTILINE)
    texts = [text for row in rows for text in re.findall(r"`([^`]+)`", row)]
    assert len(texts) > 12
    code = [path.read_text("utf-8") for path in (ROOT / "holdfast").rglob("*.py")]
    said = re.sub(r'"\s*\n\s*f?"', "", "\n".join(code))
    assert [text for text in texts if text not in said] == []


LOST_SENSOR = (
    "A lost, stale, saturated or non-finite sensor makes the answer `degraded`, which is never a "
    "safe slip, or `unknown`, on which the hand holds its grip."
)


@pytest.mark.parametrize(
    "page",
    ["README.md", "docs/for-clinicians.md", "docs/how-it-works.md", "docs/safety.md"],
)
def test_every_page_says_the_same_of_a_lost_sensor(page: str) -> None:
    assert LOST_SENSOR in " ".join((ROOT / page).read_text("utf-8").split())


@pytest.mark.parametrize(
    "page", [ROOT / "README.md", *PAGES], ids=lambda page: page.name
)
def test_no_page_says_that_any_lost_sensor_makes_the_state_unknown(page: Path) -> None:
    assert told_unknown(page.read_text("utf-8")) == []


def test_a_sentence_that_gives_up_with_the_first_lost_sensor_is_found() -> None:
    wrong = "Where sensors are lost, it answers `unknown`."
    assert told_unknown(f"{LOST_SENSOR} {wrong}") == [wrong]


LOST = re.compile(
    r"sensors? (?:is|are) (?:lost|stale|saturated)|lost sensor|bad (?:sample|reading)"
)
"""Of one sensor or some; a lost sample is one of the whole hand."""


def told_unknown(text: str) -> list[str]:
    """Sentences in which a sensor is lost and the state unknown, and nothing says how many."""
    ends = r"(?<=[.:;])\s(?=[A-Z*`])|\n\n|\n(?=- |\|)"
    sentences = [" ".join(one.split()) for one in re.split(ends, text)]
    unknown = [one for one in sentences if LOST.search(one) and "unknown" in one]
    return [one for one in unknown if not re.search("degraded|too many", one)]
