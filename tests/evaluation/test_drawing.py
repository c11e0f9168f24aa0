"""Pictures have a name for a screen reader, and follow a dark page."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from holdfast.evaluation.style import SITUATION_COLOURS

ROOT = Path(__file__).resolve().parents[2]


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
