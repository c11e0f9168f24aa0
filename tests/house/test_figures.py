"""Measured figures in the documents: each equals its JSON, or its sentence names a commit."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path

import pytest

from tools.doc_tables import SOURCES, VALUE, figures_of, fill, read_figures

ROOT = Path(__file__).resolve().parents[2]
TABLE = re.compile(r"<!-- ([\w-]+):[^\n]*-->\n.*?<!-- /\1 -->", re.DOTALL)
CODE = re.compile(r"^```.*?^```", re.DOTALL | re.MULTILINE)
PAGES = (
    "README.md",
    "docs/results.md",
    "docs/shared-control.md",
    "docs/shared-control-figures.md",
    "docs/safety.md",
    "docs/limits.md",
    "docs/faq.md",
    "docs/for-clinicians.md",
    "docs/for-students.md",
    "docs/for-boards.md",
)
"""Where readers look for figures."""
FIGURE = re.compile(
    r"(?<![\w.])(?:\d+ of (?:the |a )?\d+"
    r"|0\.\d+(?! (?:N|mm|m|MB|V)\b)"
    r"|\d[\d.,]* (?:ms|us|s|%)(?![\w/])"
    r"|\d[\d.]* (?:times|alarms|false alarms) a minute)"
)
"""A share, a time, or how often in a minute."""
COMMIT = re.compile(r"commit `?[0-9a-f]{7,}")
GIVEN = (
    # how figures are stated
    "95 % interval",
    "95 % quantile",
    "0.25 s",
    "8 of 10 has",
    "0.44 to 0.97",
    "For 0.1 on either side",
    "to about 0.1 on either side",
    # definitions of what is measured
    "over 0.3 s later",
    "0.5 N 150 ms later",
    "knows 20 ms after",
    "0.2 s after the contact's begin to 0.15 s before",
    "the first 0.2 s of a contact",
    "at most 0.5 false alarms",
    "at one false alarm a minute",
    "0.6 s of the contact",
    "a target of 2 N or less",
    "grip within 2 s",
    "of 4 N or less",
    "within 1.2 s by 2 N",
    # what scenes assume and what was varied in them
    "a lag of 50 ms",
    "tug of 60 ms",
    "tug of 60 to 80 ms",
    "open 0.3 to 1 s after",
    "opens for 50 ms",
    "for 150 ms it is",
    "friction 0.2 to 1.2",
    "smoothing of 30 ms",
    "gain of 0.4",
    "some 50 ms nothing",
    "first 50 ms of a hand-over",
    "within 0.1 s, mostly",
    # settings of the software, held by tests of their own
    "slowly after 1 s",
    "for 300 ms",
    "300 ms less 100 ms",
    "over 200 ms larger",
    "by 6 ms a second",
    "by more than 100 ms",
    "every 0.3 s",
    "After 0.3 s without a word",
    "pulses of 60 ms",
    "more than 0.12 N",
    "within 10 %",
    "lie 20 ms",
)
"""Figures that nothing measured: definitions, settings, assumptions. Words around each."""


def sentences(text: str) -> Iterator[str]:
    """The sentences of a page, without its tables, code, links and marked figures."""
    text = VALUE.sub("MARKED", CODE.sub("", TABLE.sub("", text)))
    text = re.sub(r"\]\([^)]*\)", "]", text)
    for paragraph in re.split(r"\n\s*\n|\n(?=[ ]*(?:- |\d+\. |\|))", text):
        if not paragraph.lstrip().startswith("|"):
            words = " ".join(paragraph.split())
            yield from re.split(r"(?<=[.!?:;]) (?=[A-Z*`\[(])", words)


def unproven(text: str) -> list[str]:
    """Sentences with a figure that stands in no mark, is not given, and names no commit."""
    found = []
    for sentence in sentences(text):
        rest = sentence
        for words in GIVEN:
            rest = rest.replace(words, "")
        if FIGURE.search(rest) and not COMMIT.search(sentence):
            found.append(sentence)
    return found


@pytest.mark.parametrize("page", SOURCES)
def test_every_figure_of_a_page_equals_its_json_in_the_repository(
    page: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(ROOT)
    assert {Path(place).parent.as_posix() for place in SOURCES[page].values()} <= {
        "docs/measured"
    }
    tables, values = figures_of(page, read_figures(page))
    text = Path(page).read_text("utf-8")
    copy = tmp_path / "page.md"
    copy.write_text(text, "utf-8")
    fill(copy, tables, values)
    assert copy.read_text("utf-8") == text
    assert {found[2] for found in VALUE.finditer(text)} == set(values)
    # a tool that reads Markdown would end the paragraph there
    assert re.findall(r"^<!-- [\w-]+= -->", text, re.MULTILINE) == []


@pytest.mark.parametrize("page", PAGES)
def test_a_measured_figure_in_a_sentence_stands_in_a_mark_or_names_its_commit(
    page: str,
) -> None:
    assert unproven((ROOT / page).read_text("utf-8")) == []


@pytest.mark.parametrize(
    "sentence",
    [
        "It finds 41 of 59 drops.",
        "Recall is 0.973 there.",
        "An alarm comes after 17 ms.",
        "It tightens 12.5 times a minute.",
        "Half of them, 51 %, are called.",
    ],
)
def test_a_figure_without_a_mark_is_found(sentence: str) -> None:
    assert unproven(f"# A page\n\n{sentence}\n") == [sentence]
    assert unproven(f"{sentence[:-1]} (commit 87cf3b64).") == []
    marked = FIGURE.sub("<!-- a-name= -->9 of 9<!-- = -->", sentence)
    assert unproven(marked) == []
