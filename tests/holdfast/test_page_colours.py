"""Colours of the live page and of reports: distinguished by colour-blind readers, and readable."""

from __future__ import annotations

import re
from itertools import combinations
from pathlib import Path

import pytest
from colour_vision import VISIONS, apart, contrast

from holdfast.evaluation.style import SITUATION_COLOURS
from holdfast.live import page

CSS = (Path(page.__file__).parent / "page.css").read_text("utf-8")
TOGETHER = {
    "lines of the plot": ("load", "grip", "target"),
    "the band of p(risky)": ("risk", "problem"),
    "the strip of situations": (
        "unknown",
        "nothing",
        "grasp",
        "safe_slip",
        "risky_slip",
    ),
}
"""What a reader tells apart by colour in one place."""
FAR = 12.0
"""Five times what a reader who looks for it can just see."""


def colours(dark: bool) -> dict[str, str]:
    light, _, rest = CSS.partition("@media (prefers-color-scheme: dark)")
    shades = dict(re.findall(r"--(\w+): (#\w+)", light))
    return shades | dict(re.findall(r"--(\w+): (#\w+)", rest)) if dark else shades


@pytest.mark.parametrize("vision", VISIONS)
@pytest.mark.parametrize("place", TOGETHER)
@pytest.mark.parametrize("dark", [False, True])
def test_colours_of_one_place_are_told_apart(
    place: str, vision: str, dark: bool
) -> None:
    shades = colours(dark)
    for one, other in combinations(TOGETHER[place], 2):
        assert apart(shades[one], shades[other], vision) >= FAR, (one, other)


@pytest.mark.parametrize("vision", VISIONS)
def test_situations_in_reports_are_told_apart(vision: str) -> None:
    for one, other in combinations(SITUATION_COLOURS, 2):
        assert apart(one, other, vision) >= FAR, (one, other)


@pytest.mark.parametrize("dark", [False, True])
def test_lines_and_words_can_be_read_on_their_ground(dark: bool) -> None:
    shades = colours(dark)
    for name in ("load", "grip", "target", "risk", "faint", "problem"):
        assert contrast(shades[name], shades["panel"]) >= 4.5, name
    # the banner of an alarm has white words
    assert contrast("#fff", shades["alarm"]) >= 4.5
