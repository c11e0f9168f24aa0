"""Pictures have a name for a screen reader, and follow a dark page."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from pathlib import Path

import pytest
from jinja2 import UndefinedError
from matplotlib.figure import Figure

from holdfast.evaluation.html import render
from holdfast.evaluation.style import (
    DARK_INSTEAD,
    INK,
    SITUATION_COLOURS,
    svg,
    with_label,
)
from tools.harness import for_any_page

ROOT = Path(__file__).resolve().parents[2]


@pytest.fixture
def figure() -> Figure:
    drawn = Figure()
    left, right, unseen = drawn.subplots(1, 3)
    drawn.suptitle("simulated")
    left.plot([0, 1], label='p < "0.05" & less')
    left.set(title="thesis", xlabel="time, s", ylabel="force,\nN")
    right.plot([0, 1], color=INK)
    right.set(xlabel="Hz")
    unseen.set(xlabel="not shown")
    unseen.set_visible(False)
    return drawn


def test_a_picture_names_its_kind_titles_axes_and_lines(figure: Figure) -> None:
    drawn = ET.fromstring(svg(figure))
    said = 'simulated; thesis: force, N against time, s: p < "0.05" & less; Hz'
    assert (drawn.get("role"), drawn.get("aria-label")) == ("img", said)
    assert drawn[0].text == said


def test_the_name_of_a_picture_is_escaped() -> None:
    named = ET.fromstring(with_label('<svg viewBox="0 0 1 1"><path/></svg>', 'a < "b"'))
    assert named.get("aria-label") == named[0].text == 'a < "b"'
    assert named.get("viewBox") == "0 0 1 1"


def test_ink_and_paper_of_a_file_change_on_a_dark_page(figure: Figure) -> None:
    text = for_any_page(svg(figure))
    ET.fromstring(text)
    used = set(re.findall(r"(?:fill|stroke): (#[0-9a-f]{6})", text))
    assert {"#ffffff", INK} <= used & set(DARK_INSTEAD)
    for light in used & set(DARK_INSTEAD):
        assert f'"fill: {light}"]{{fill:{DARK_INSTEAD[light]}!important}}' in text


def test_text_in_a_template_is_escaped_and_a_forgotten_value_is_an_error(
    tmp_path: Path,
) -> None:
    (tmp_path / "page.html").write_text("<p>{{ text }}", encoding="utf-8")
    assert render("page.html", tmp_path, text="a < b") == "<p>a &lt; b"
    with pytest.raises(UndefinedError):
        render("page.html", tmp_path)


@pytest.mark.parametrize(
    "page", ["holdfast/live/page/page.css", "examples/browser/situations.js"]
)
def test_pages_of_their_own_give_situations_the_colours_of_every_report(
    page: str,
) -> None:
    text = (ROOT / page).read_text("utf-8")
    found = re.findall(
        r'(?:nothing|grasp|safe.slip|risky.slip)"?: "?(#[0-9a-f]{6})', text
    )
    assert tuple(found) == SITUATION_COLOURS
