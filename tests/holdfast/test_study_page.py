"""docs/study.md does what it says: its card, its commands and what they print."""

from __future__ import annotations

import os
import re
import shlex
import sys
from collections.abc import Callable
from pathlib import Path
from threading import Event, Thread

import pytest
from study_bench import options

from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.sessions.study.console import KEYS
from holdfast.sessions.study.protocol import KINDS, read_study

ROOT = Path(__file__).resolve().parents[2]
PAGE = ROOT / "docs/study.md"
BLOCK = re.compile(r"```(sh|toml|text)\n(.*?)```", re.DOTALL)


@pytest.mark.filterwarnings("ignore")
def test_the_page_s_card_and_commands_run_and_print_what_it_shows(
    run: Callable[..., tuple[int, str, str]],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    # The trials take no time, and the operator presses space ten times a second.
    monkeypatch.setattr("holdfast.sessions.study.run.RunClock", VirtualClock)
    reading, writing = os.pipe()
    monkeypatch.setattr(sys, "stdin", os.fdopen(reading))
    ended = Event()

    def press() -> None:
        while not ended.wait(0.1):
            os.write(writing, b" ")

    Thread(target=press, daemon=True).start()
    printed, shown = "", []
    for kind, text in BLOCK.findall(PAGE.read_text("utf-8")):
        if kind == "toml":
            Path("my-study.toml").write_text(text, encoding="utf-8")
        elif kind == "text":
            shown.append((text, printed))
        elif "my-study.toml" in text:
            results = [run(*shlex.split(line)[1:]) for line in text.splitlines()]
            assert [code for code, _, _ in results] == [0] * len(results), results
            printed = "".join(out for _, out, _ in results)
    ended.set()
    assert [old for old, _ in shown] == [new for _, new in shown] != []
    assert "\ntry: 2 trials of 1 person" in printed
    assert (tmp_path / "try/p01/report.html").exists()


def test_the_page_s_commands_with_a_hand_have_options_that_exist() -> None:
    lines = [
        line
        for kind, text in BLOCK.findall(PAGE.read_text())
        for line in text.splitlines()
    ]
    commands = [line for line in lines if line.startswith("holdfast study thesis")]
    assert len(commands) == 6
    for line in commands:
        options(Path("thesis"), Path("out"), *shlex.split(line)[3:])
    assert read_study("thesis").minutes == 49.0


def test_the_page_names_every_key_and_every_kind_of_step() -> None:
    page = PAGE.read_text("utf-8")
    letters = [letter for letter in KEYS if letter.isalpha()]
    assert [one for one in letters if f"| `{one}` |" not in page] == []
    assert [kind for kind in KINDS if kind not in page] == []
