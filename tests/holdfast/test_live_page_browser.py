"""The live page in a browser, on a phone and on a desk: what a person reads there."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import msgspec
import pytest
from hazard_marks import STALE_PAGE
from headless_browser import Tab, browser, needs_chromium
from page_bench import Served, sample, served

from holdfast.core.hand_card import read_hand_card
from holdfast.live.page.process import DIED
from holdfast.live.page.run_page import drawn_hand

pytestmark = needs_chromium
STATE, DETAIL = (
    "document.getElementById('state').textContent",
    "document.getElementById('detail')",
)


@pytest.fixture(scope="module")
def tab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


def opened(tab: Tab, page: Served, width: int = 1280, **how: Any) -> None:
    tab.problems.clear()
    tab.open(page.url, width, 844, **how)
    tab.wait_until(f"{STATE} !== 'no connection'")


def text_of(tab: Tab, name: str) -> str:
    return str(tab.value(f"document.getElementById('{name}').innerText"))


@pytest.mark.parametrize("dark", [False, True])
@pytest.mark.parametrize("width", [390, 1280])
def test_a_phone_and_a_desk_show_state_forces_and_faults_in_words(tab, width, dark):
    with served() as page:
        page.frame(*map(sample, range(300)))
        opened(tab, page, width, dark=dark)
        page.frame(sample(300))
        tab.wait_until(f"{STATE} === 'grasp'")
        lost = sample(301, "unknown", v=[1, 1, 0, 1, 1, 1])
        lost["sample"]["why"] = ["", "", "nack", "", "", ""]
        lost["sample"]["answer"]["why"] = "sensors"
        page.frame(lost)
        tab.wait_until(f"{STATE} === 'unknown'")
        assert (
            tab.value(f"{DETAIL}.textContent")
            == "too few sensors can be used; lost: index"
        )
        sensors, numbers = text_of(tab, "sensors"), text_of(tab, "numbers")
        assert tab.value("document.documentElement.scrollWidth <= window.innerWidth")
        assert tab.value("document.querySelectorAll('#hand .lost').length") == 1
        assert tab.value(
            "document.querySelector('#hand .arrow').getAttribute('x2') > 3"
        )
        background = "getComputedStyle(document.body).backgroundColor"
        assert (tab.value(background) == "rgb(255, 255, 255)") is not dark
        assert tab.problems == []
    assert "0.67 N" in sensors
    assert "does not answer" in sensors
    assert "1.67 N" in numbers


def test_an_axis_that_the_hand_does_not_measure_is_a_dash_and_no_zero(tab):
    usual = read_hand_card("six-fingertips")
    yz = [msgspec.structs.replace(one, measures="yz") for one in usual.contacts[:1]]
    hand = replace(usual, contacts=(*yz, *usual.contacts[1:]))
    with served(hand=drawn_hand(hand, 6)) as page:
        page.frame(*map(sample, range(10)))
        opened(tab, page)
        page.frame(sample(10))
        tab.wait_until(f"{STATE} === 'grasp'")
        sensors = text_of(tab, "sensors")
        assert tab.problems == []
    assert sensors.count("0.10 N, x \u2013") == 1
    assert sensors.count("0.10 N") == 6


@STALE_PAGE.mark
def test_a_command_that_does_not_leave_is_told_where_the_target_stands(tab):
    with served(grip=True) as page:
        opened(tab, page)
        page.frame(sample(0))
        tab.wait_until("document.body.innerText.includes('9.40 N (tighten')")
        away = sample(1)
        away["sample"]["grip"]["leaves"] = False
        page.frame(away)
        tab.wait_until("document.body.innerText.includes('NO COMMAND LEAVES')")
        assert "9.40 N" not in text_of(tab, "numbers")


@STALE_PAGE.mark
def test_a_page_that_hears_nothing_never_shows_an_old_state(tab):
    with served() as page:
        opened(tab, page)
        page.frame(sample(0, "safe_slip"))
        tab.wait_until(f"{STATE} === 'safe slip'")
        page.frame(now_s=1.0)
        tab.wait_until(f"{STATE} === 'no answers'")
        page.frame(sample(1, "safe_slip"), now_s=1.1)
        tab.wait_until(f"{STATE} === 'safe slip'")
        tab.wait_until(f"{STATE} === 'no connection'")  # no frame comes
        page.frame(sample(2, "safe_slip"), now_s=1.2)
        tab.wait_until(f"{STATE} === 'safe slip'")
        assert text_of(tab, "spoken") != ""
    tab.wait_until(f"{STATE} === 'the test has ended'")


def test_a_risky_slip_is_red_while_it_lasts_and_then_a_line_beside_the_state(tab):
    red = "getComputedStyle(document.getElementById('now')).backgroundColor"
    echo = "document.getElementById('echo').textContent"
    with served() as page:
        opened(tab, page)
        # a frame is shown by its riskiest sample
        page.frame(sample(0), sample(1, "risky_slip"), sample(2))
        tab.wait_until(f"{STATE} === 'risky slip'")
        assert tab.value(red) == "rgb(179, 38, 30)"
        assert tab.value(echo) == ""
        # a screen reader is spoken to once a second, and does not miss it
        tab.value(
            "{ const now = performance.now(); performance.now = () => now + 1e3 }"
        )
        page.frame(sample(60, "nothing"))
        tab.wait_until(f"{STATE} === 'nothing'")
        assert tab.value(red) != "rgb(179, 38, 30)"
        assert tab.value(echo) == "risky slip 0.4 s ago"
        assert text_of(tab, "spoken") == "risky slip"
        page.frame(sample(450))
        tab.wait_until(f"{STATE} === 'grasp'")
        assert tab.value(echo) == "risky slip 3.0 s ago"
        page.frame(sample(760))
        tab.wait_until(f"{echo} === ''")


@STALE_PAGE.mark
@pytest.mark.parametrize("end", [DIED, "the run failed", "the run has ended"])
def test_what_was_said_before_the_end_stands_under_the_messages_alone(tab, end):
    with served() as page:
        opened(tab, page)
        page.frame({"said": "the hand may close now"}, sample(0, "risky_slip"))
        tab.wait_until(f"{STATE} === 'risky slip'")
        page.frame({"end": end})
        tab.wait_until(f"{STATE} === '{end}'")
        now = text_of(tab, "now")
        assert text_of(tab, "said").splitlines() == [end, "the hand may close now"]
    assert "may close" not in now
    assert "slip" not in now.lower().replace(end, "")


def test_a_pause_keeps_the_picture_and_the_numbers_go_on(tab):
    pause = "document.getElementById('pause')"
    with served() as page:
        opened(tab, page)
        page.frame(sample(0))
        tab.wait_until(f"{STATE} === 'grasp'")
        tab.value(f"{pause}.click()")
        page.frame(sample(1, x=[9.0] * 18))
        tab.wait_until(
            "document.getElementById('numbers').innerText.includes('27.00 N')"
        )
        assert "0.67 N" in text_of(tab, "sensors")
        assert tab.value(f"{pause}.textContent") == "Resume"
        tab.value(f"{pause}.click()")
        assert "9.00 N" in text_of(tab, "sensors")


def test_what_a_message_says_is_text_and_never_markup(tab, tmp_path: Path):
    with served(source="<img src=x onerror=alert(1)>") as page:
        opened(tab, page)
        page.frame({"said": "<script>alert(1)</script>"}, sample(0))
        tab.wait_until(
            "document.getElementById('said').textContent.includes('<script>')"
        )
        assert (
            tab.value("document.querySelectorAll('#said script, #about img').length")
            == 0
        )
        assert tab.problems == []
