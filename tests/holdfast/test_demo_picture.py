"""The README's picture: drawn from a closed loop, with its end where nothing moves."""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET

import pytest
from loop_bench import MODEL

from examples.demo import demo_picture
from holdfast.edge_runtime.model import Model


@pytest.fixture(scope="module")
def seen() -> list[demo_picture.Seen]:
    return demo_picture.watch(Model(MODEL))


def test_the_bottle_is_lost_without_and_kept_with_the_grip_controlled(
    seen: list[demo_picture.Seen],
) -> None:
    bare_fall, _, held_fall, held_pass = seen
    assert bare_fall.outcome.dropped
    assert bare_fall.moved_mm[-1] > 200.0
    assert not held_fall.outcome.dropped
    assert held_fall.moved_mm[-1] < 20.0
    assert held_fall.grip_n[-1] > 2 * held_fall.grip_n[0]
    # the hand-over ends with the other person, and with an open hand
    assert held_pass.moved_mm[-1] > 100.0
    assert held_pass.grip_n[-1] == pytest.approx(0.0, abs=0.1)


def test_a_reader_without_animation_sees_the_end(
    seen: list[demo_picture.Seen], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_picture, "watch", lambda _: seen)
    drawn = demo_picture.picture(Model(MODEL))
    root = ET.fromstring(drawn)
    assert root.get("role") == "img"
    still, _, moving = drawn.partition("@media(prefers-reduced-motion:no-preference)")
    ends = [float(px) for px in re.findall(r"translateY\((\S+?)px\)", still)]
    assert ends == pytest.approx(
        [
            sign * demo_picture.PX_PER_MM * seen[k].moved_mm[-1]
            for k, sign in ((0, 1), (2, 1), (3, -1))
        ],
        abs=5.0,
    )
    assert "animation" not in still
    assert moving.count("@keyframes") == 2 + 2 * 3
    assert len(drawn) < 40_000


def test_for_a_phone_the_same_hands_stand_one_below_the_other(
    seen: list[demo_picture.Seen], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(demo_picture, "watch", lambda _: seen)
    drawn = {k: demo_picture.picture(Model(MODEL), across=k) for k in (1, 3)}
    places = {}
    for across, text in drawn.items():
        width, height = map(int, re.findall(r'viewBox="0 0 (\d+) (\d+)"', text)[0])
        panels = re.findall(r'<g transform="translate\((\d+) (\d+)\)">', text)
        places[across] = [(int(x), int(y)) for x, y in panels]
        assert all(x + 300 <= width and y + 470 <= height for x, y in places[across])
        tops = [
            float(y) for y in re.findall(r'<text class="s" x="\S+" y="(\d+)"', text)
        ]
        assert max(tops) < height
    assert places == {1: [(0, 0), (0, 470), (0, 940)], 3: [(0, 0), (300, 0), (600, 0)]}
    lines = [set(re.findall(r"<polyline .*", text)) for text in drawn.values()]
    assert lines[0] == lines[1]
