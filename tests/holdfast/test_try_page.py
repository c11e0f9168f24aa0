"""The page of a hand to pull at: what a person does there, on a desk and on a phone."""

from __future__ import annotations

import re
import runpy
import sys
from collections.abc import Iterator
from contextlib import redirect_stdout
from io import StringIO
from pathlib import Path

import pytest
from headless_browser import Tab, browser, needs_chromium

from benchmarks.runtimes.c_programs import WASM

ROOT = Path(__file__).resolve().parents[2]
RELEASED = ROOT / "models/holdfast-150hz.onnx"
MOST_BYTES = 3_000_000
SAID = "now.action.said && at('said').textContent"
HELPED = "((yes) => { if (at('helped').checked !== yes) at('helped').click(); })"


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    if not WASM.is_installed:
        pytest.skip(f"the browser's example needs {', '.join(WASM.programs)}")
    made = tmp_path_factory.mktemp("pages")
    script = str(ROOT / "examples/browser/build.py")
    with pytest.MonkeyPatch.context() as patched, redirect_stdout(StringIO()) as said:
        patched.setattr(sys, "argv", [script, str(RELEASED), str(made)])
        runpy.run_path(script, run_name="__main__")
    assert re.fullmatch(r"(\S+\.html: [12]\.\d\d MB\n){2}", said.getvalue())
    return made


@pytest.fixture(scope="module")
def tab(folder: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Tab]:
    with browser(tmp_path_factory.mktemp("profile")) as one:
        yield one


def opened(tab: Tab, folder: Path, width: int = 1366, height: int = 768) -> Tab:
    tab.problems.clear()
    tab.open((folder / "try.html").as_uri(), width, height)
    tab.wait_until("now.view && at('said').textContent.startsWith('Held')")
    # Real time: the story is the same at any speed.
    tab.value("document.querySelector('input[name=speed]').click()")
    return tab


def said_after(tab: Tab, button: str, helped: bool) -> str:
    tab.value(f"{HELPED}({'true' if helped else 'false'}); at('{button}').click()")
    text: str = tab.wait_until(SAID)
    return text.replace("\u00a0", " ")


def test_both_pages_are_whole_small_and_may_ask_nothing_of_any_network(folder: Path):
    for name in ("try.html", "trial.html"):
        text = (folder / name).read_text("utf-8")
        assert len(text.encode()) < MOST_BYTES
        assert "default-src 'none'" in text
        assert not re.search(r"(src|href)=\"(?!(try|trial)\.html)", text)


@needs_chromium
def test_a_pull_is_kept_with_holdfast_and_lost_without(tab: Tab, folder: Path):
    opened(tab, folder)
    kept = said_after(tab, "pull", helped=True)
    assert re.match(r"Kept: called \d\d ms after the pull began, the grip rose", kept)
    assert tab.value("now.view.touching") > 0
    lost = said_after(tab, "pull", helped=False)
    called = r"Lost after \d{3} ms: Holdfast would have called it \d+ ms after the pull began"
    assert re.match(called, lost)
    assert tab.value("now.view.touching") == 0
    assert tab.value("performance.getEntriesByType('resource').length") == 0
    assert tab.problems == []


@needs_chromium
def test_the_hand_lets_go_when_its_wearer_opens_it_whatever_holdfast_asks_for(
    tab: Tab, folder: Path
):
    opened(tab, folder)
    tab.value(f"{HELPED}(true); at('hand-over').click()")
    tab.wait_until("now.view.takes === 1")
    bare = said_after(tab, "open", helped=True)
    assert re.match(
        r"Let go (\d+) ms after the wearer opened, from \d+ N, whatever", bare
    )
    # also while it holds with all that a pull has raised the grip by
    tab.value("at('pull').click()")
    tab.wait_until("now.view.grip > now.action.grip + 5")
    assert re.match(r"Let go \d+ ms after", said_after(tab, "open", helped=True))
    assert tab.value("now.view.touching") == 0
    assert tab.problems == []
