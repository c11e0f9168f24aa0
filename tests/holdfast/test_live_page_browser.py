"""The live page in a browser, on a phone and on a desk: what a person reads there."""

from __future__ import annotations

import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hazard_marks import STALE_PAGE
from headless_browser import Tab, browser, needs_chromium
from page_bench import Served, sample, served

from holdfast.core.hand_card import read_hand_card, shipped_hands
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
    assert "0.67 N\t0.10 N\tgood" in sensors
    assert "does not answer" in sensors
    assert "grip of either side\n1.67 N" in numbers
    assert "lost samples\nnone" in numbers


def test_the_wearers_own_command_stands_beside_the_fingers_and_silence_is_unknown(tab):
    with served() as page:
        intent = {"wants": "open", "link": "live"}
        page.frame(sample(0, intent=intent))
        opened(tab, page, 390)
        assert "wearer's command\nopen" in text_of(tab, "numbers")
        page.frame(sample(1, intent=intent | {"wants": "unknown", "link": "expired"}))
        words = "unknown: its sender is silent"
        tab.wait_until(
            f"document.getElementById('numbers').innerText.includes('{words}')"
        )
        assert tab.value("document.documentElement.scrollWidth <= window.innerWidth")
        assert tab.problems == []


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


def test_a_risky_slip_of_one_sample_is_a_red_alarm_for_two_seconds(tab):
    red = "getComputedStyle(document.getElementById('now')).backgroundColor"
    with served() as page:
        opened(tab, page)
        page.frame(sample(0), sample(1, "risky_slip"), sample(2))
        tab.wait_until(f"{STATE} === 'risky slip'")
        page.frame(sample(60))
        tab.wait_until(f"{DETAIL}.textContent.startsWith('0.4 s ago, now grasp')")
        assert tab.value(STATE) == "risky slip"
        assert tab.value(red) == "rgb(179, 38, 30)"
        page.frame(sample(450))
        tab.wait_until(f"{STATE} === 'grasp'")
        assert "risky slip 3.0 s ago" in tab.value(f"{DETAIL}.textContent")
        assert tab.value(red) != "rgb(179, 38, 30)"


def test_a_page_that_is_opened_after_a_risky_slip_says_when_it_was(tab):
    with served() as page:
        page.frame(sample(0, "risky_slip"), *(sample(k) for k in range(1, 150)))
        opened(tab, page)
        assert tab.value(STATE) == "risky slip"
        assert tab.value(f"{DETAIL}.textContent").startswith("1.0 s ago, now grasp")


@pytest.mark.parametrize(("grip", "says"), [(False, "moves no hand"), (True, "sends")])
def test_the_page_says_whether_a_hand_is_moved(tab, grip, says):
    with served(grip=grip) as page:
        page.frame(sample(0))
        opened(tab, page)
        assert says in text_of(tab, "moves")


def test_the_end_says_why(tab):
    with served() as page:
        page.frame(sample(0))
        opened(tab, page)
        page.frame({"said": "the source has ended; samples: 1"})
        tab.wait_until("document.getElementById('said').innerText !== ''")
    tab.wait_until(f"{STATE} === 'the test has ended'")
    assert "the source has ended; samples: 1" in tab.value(f"{DETAIL}.textContent")


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


def test_the_page_of_a_gripper_of_two_pads_shows_these_and_no_word_of_another_hand(tab):
    hand = drawn_hand(read_hand_card("two-pad-gripper"), 2)
    with served(hand=hand) as page:
        grasp = sample(0, x=[0.1, 0.0, 1.0] * 2, v=[1, 0], why=["", "nack"])
        page.frame(grasp)
        opened(tab, page)
        tab.wait_until(f"{STATE} === 'grasp'")
        assert tab.value(f"{DETAIL}.textContent") == "lost: right jaw; light object"
        assert "left jaw\t1.00 N\t0.10 N\tgood" in text_of(tab, "sensors")
        assert tab.value("document.querySelectorAll('#hand .pad').length") == 2
        source = tab.value("document.documentElement.outerHTML").lower()
        assert not re.search(r"thumb|finger|\bsix\b", source)
        assert tab.problems == []


@pytest.mark.parametrize("name", shipped_hands())
def test_the_page_draws_every_sensor_of_a_hand_card_at_a_place_of_its_own(tab, name):
    card = read_hand_card(name)
    n = card.n_sensors
    with served(hand=drawn_hand(card, n)) as page:
        page.frame(sample(0, x=[0.1, 0.0, 1.0] * n, v=[1] * n, why=[""] * n))
        opened(tab, page)
        tab.wait_until(f"{STATE} === 'grasp'")
        groups = "[...document.querySelectorAll('#hand g')]"
        places = tab.value(f"{groups}.map((g) => g.getAttribute('transform'))")
        assert len(set(places)) == len(places) == n
        labels = f"{groups}.map((g) => g.querySelector('text').textContent)"
        assert tab.value(labels) == list(card.sensor_names)
        assert tab.problems == []
