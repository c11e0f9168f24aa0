"""What a person types at a terminal: after Ctrl-Z, arrow keys, pasted text, keys too early."""

from __future__ import annotations

import json
import os
import pty
import select
import shutil
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hazard_marks import DEAF_TERMINAL
from recorder_bench import (
    ROOT,
    cup_pull,
    never,
    on_terminal,
    states_in,
    terminal_of_its_own,
    wait_on_terminal_for,
)
from study_bench import Study

from holdfast.live.running import RunClock
from holdfast.sessions.recorder.terminal import (
    ASK_FOR_PASTE_MARKS,
    NO_PASTE_MARKS,
    TEXT,
    TEXT_IS_NO_KEY,
    Display,
    Keys,
    RunContext,
    listening,
)
from holdfast.sessions.study.console import KEYS, Console, Key

SOON_S = 5.0
"""A key that was pressed is there much sooner."""


class Operator:
    """A person at a terminal; typed: what they type when a prompt appears."""

    def __init__(self, master: int, slave: int, keys: Keys) -> None:
        self.master, self.slave, self.keys = master, slave, keys
        self.typed = b""
        self.messages: list[str] = []
        context = RunContext(RunClock(), keys, Display(self.report), never)
        self.console = Console(context)

    def types(self, typed: bytes) -> None:
        os.write(self.master, typed)

    def report(self, line: str) -> None:
        self.messages.append(line)
        typed, self.typed = self.typed, b""
        self.types(typed)

    def note(self, typed: bytes) -> str | None:
        """What becomes of a note that is typed once the prompt is there."""
        self.typed = typed
        return self.console.text("note")


@pytest.fixture
def operator() -> Iterator[Operator]:
    """At a terminal of no session, as `setsid` leaves one."""
    master, slave = pty.openpty()
    with listening(slave) as keys:
        yield Operator(master, slave, keys)
    os.close(master)
    os.close(slave)


LINE_MODE = termios.ICANON | termios.ECHO
"""A terminal that shows what is typed, and passes it on with Enter."""


def line_mode(slave: int) -> int:
    return termios.tcgetattr(slave)[3] & LINE_MODE


class Screen:
    """What a terminal shows, read piece by piece."""

    def __init__(self, master: int) -> None:
        self.master, self.unread = master, b""

    def types(self, typed: str) -> None:
        os.write(self.master, typed.encode())

    def reads_until(self, word: str) -> bytes:
        """All up to a word."""
        while word.encode() not in self.unread:
            assert select.select([self.master], [], [], 60.0)[0], self.unread
            self.unread += os.read(self.master, 4096)
        seen, _, self.unread = self.unread.partition(word.encode())
        return seen


# -- Ctrl-Z


def shell_on(slave: int, shell: str) -> subprocess.Popen[bytes]:
    """A shell with job control at a terminal."""
    path = shutil.which(shell)
    if path is None:
        pytest.skip(f"no {shell} on this machine")
    quiet = ["--norc", "--noprofile"] if shell == "bash" else []
    return subprocess.Popen(
        [path, *quiet, "-i"],
        cwd=ROOT,
        env=os.environ | {"PS1": "PROMPT> ", "TERM": "xterm"},
        stdin=slave,
        stdout=slave,
        stderr=slave,
        preexec_fn=terminal_of_its_own,
    )


@DEAF_TERMINAL.mark
@pytest.mark.parametrize(
    ("shell", "back"), [("bash", ["fg"]), ("dash", ["fg"]), ("bash", ["bg", "fg"])]
)
def test_after_ctrl_z_the_keys_work_again_and_the_shell_has_its_terminal(
    tmp_path: Path, shell: str, back: list[str]
) -> None:
    master, slave = pty.openpty()
    words = " ".join(map(str, cup_pull(tmp_path)))
    with shell_on(slave, shell) as run:
        try:
            screen = Screen(master)
            screen.reads_until("PROMPT>")
            screen.types(f"{sys.executable} -m holdfast record {words}\n")
            screen.reads_until("next: cup, pull")
            screen.types("\x1a")
            seen = screen.reads_until("PROMPT>")
            assert NO_PASTE_MARKS in seen
            # bash sets a mode of its own while a line is typed, dash none
            assert shell == "bash" or line_mode(slave) == LINE_MODE
            for word in back:
                screen.types(f"{word}\n")
                # bash asks for the marks too, before each of its prompts
                screen.reads_until("PROMPT>" if word == "bg" else "record --source")
            screen.reads_until(ASK_FOR_PASTE_MARKS.decode())
            screen.types(" ")
            screen.reads_until("recording p01")
            screen.types("q")
            screen.reads_until("PROMPT>")
        finally:
            run.kill()
            # The program gets SIGHUP with its terminal.
            os.close(master)
    os.close(slave)


@DEAF_TERMINAL.mark
def test_a_mode_that_another_program_left_is_set_again_before_the_next_key(
    operator: Operator,
) -> None:
    mode = termios.tcgetattr(operator.slave)
    mode[3] |= LINE_MODE
    termios.tcsetattr(operator.slave, termios.TCSANOW, mode)
    assert operator.keys.letter() == ""
    operator.types(b"a")
    assert operator.keys.letter(SOON_S) == "a"


# -- keys of several bytes


SEQUENCES = {
    "up": b"\x1b[A",
    "up, application mode": b"\x1bOA",
    "ctrl-left": b"\x1b[1;5D",
    "delete": b"\x1b[3~",
    "F1 of the Linux console": b"\x1b[[A",
    "alt-a": b"\x1ba",
    "alt-up": b"\x1b\x1b[A",
    "a colour that the terminal answers": b"\x1b]11;rgb:aaaa/eeee/kkkk\x1b\\",
    "paste": b"\x1b[200~save a life\nquick\n\x1b[201~",
}


@DEAF_TERMINAL.mark
@pytest.mark.parametrize("sequence", SEQUENCES.values(), ids=list(SEQUENCES))
@pytest.mark.parametrize("at_once", [True, False])
def test_a_key_of_several_bytes_is_no_letter_however_its_bytes_come(
    operator: Operator, sequence: bytes, at_once: bool
) -> None:
    letters = ""
    for byte in (
        [sequence] if at_once else [sequence[k : k + 1] for k in range(len(sequence))]
    ):
        operator.types(byte)
        letters += operator.keys.pressed()
    operator.types(b"k")
    while not operator.keys.last:
        letters += operator.keys.pressed(SOON_S)
    assert (letters, operator.keys.last) == ("keep", "k")


@DEAF_TERMINAL.mark
@pytest.mark.parametrize(
    ("typed", "note"),
    [
        (b"slipped\x1b[D\x1b[A twice\n", "slipped twice"),
        (b"\x1b[200~fell down\nquite bad\n\x1b[201~\n", "fell down quite bad"),
        (b"fell down\nquite bad, a bruise\n", "fell down quite bad, a bruise"),
        (b"dropped\x1b", ""),
        (b"caf\xc3\xa9s\x7f\n", "café"),
    ],
    ids=["arrows", "paste", "paste without marks", "Escape", "backspace"],
)
def test_a_note_is_what_was_typed_and_pasted_and_leaves_no_key(
    operator: Operator, typed: bytes, note: str
) -> None:
    assert operator.note(typed) == note
    assert operator.keys.letter() == ""


@DEAF_TERMINAL.mark
@pytest.mark.parametrize("marks", [(b"\x1b[200~", b"\x1b[201~"), (b"", b"")])
def test_pasted_lines_are_no_keys_and_the_operator_is_told(
    operator: Operator, marks: tuple[bytes, bytes]
) -> None:
    operator.types(marks[0] + b"save\na lot\n" + marks[1])
    operator.typed = b"n"
    assert operator.console.key(60.0) == Key.NOTE
    assert operator.messages == [TEXT_IS_NO_KEY]


@DEAF_TERMINAL.mark
def test_keys_that_come_together_over_a_slow_link_are_one_and_never_hide_a_stop(
    operator: Operator,
) -> None:
    answers = []
    for typed in (b"  ", b" a", b"ssq", b"xy"):
        operator.types(typed)
        answers.append(operator.keys.choice(KEYS, SOON_S))
    assert answers == [" ", "a", "q", TEXT]


# -- typed too early


@DEAF_TERMINAL.mark
@pytest.mark.parametrize(
    ("typed", "key"), [(b"  s\n", ""), (b" a ", "a"), (b"rqs", "q"), (b"\x1b[A", "")]
)
def test_what_was_typed_before_a_question_is_dropped_but_for_stop_and_adverse_event(
    operator: Operator, typed: bytes, key: str
) -> None:
    operator.types(typed)
    operator.keys.drop()
    operator.keys.drop()
    assert operator.keys.letter() == key
    assert operator.keys.letter() == ""


@DEAF_TERMINAL.mark
def test_keys_that_were_typed_early_skip_no_step_of_a_study(tmp_path: Path) -> None:
    talk = Study(tmp_path)
    master, slave = pty.openpty()
    words = ["--source", "virtual://ft232h", "--person", "p01"]
    with on_terminal(slave, talk.path, "--out", talk.out, *words, verb="study") as run:
        os.write(master, b"   ")
        wait_on_terminal_for(master, "step 1 of 2, Welcome")
        os.write(master, b"   ")
        wait_on_terminal_for(master, "step 1 of 2, Questions")
        os.write(master, b"a")
        wait_on_terminal_for(master, "what happened?")
        os.write(master, b"fell\n2\nn\n")
        wait_on_terminal_for(master, "how severe?")
        os.write(master, b"2\n")
        wait_on_terminal_for(master, "go on?")
        os.write(master, b"n\n")
        assert run.wait(timeout=300) == 0
    os.close(master)
    assert talk.done() == [0]
    (detail,) = talk.entries("adverse_detail")
    assert detail["text"] == "fell 2 n", "the lines came at once, as a paste"


@DEAF_TERMINAL.mark
@pytest.mark.parametrize(("early", "then"), [(b" ", b"q"), (b"q", b"")])
def test_a_key_before_the_recorder_asks_begins_no_trial_but_stops(
    tmp_path: Path, early: bytes, then: bytes
) -> None:
    master, slave = pty.openpty()
    with on_terminal(slave, *cup_pull(tmp_path)) as run:
        wait_on_terminal_for(master, "opening virtual")
        os.write(master, early)
        wait_on_terminal_for(master, "next: cup, pull")
        os.write(master, then)
        assert run.wait(timeout=300) == 0
    os.close(master)
    assert states_in(tmp_path) == []


# -- a torn journal


@DEAF_TERMINAL.mark
@pytest.mark.parametrize("goes_on", [False, True])
def test_a_report_tells_a_torn_last_line_of_the_journal(
    tmp_path: Path, goes_on: bool, run: Callable[..., tuple[int, str, str]]
) -> None:
    talk = Study(tmp_path)
    talk.run(" nfell\n q")
    journal = talk.home / "study.jsonl"
    lines = journal.read_bytes().splitlines(keepends=True)
    journal.write_bytes(b"".join(lines[:-2]) + lines[-2][:-25])
    if goes_on:
        talk.run("q")
        assert any("1 torn line of the journal" in one for one in talk.messages)
    words = (talk.path, "--out", talk.out, "--person", "p01", "--report")
    code, out, _ = run("study", *words)
    assert (code, "1 torn line of the journal" in out) == (0, True)
    assert "tore 1 line of the journal" in (talk.home / "report.html").read_text()
    assert json.loads((talk.home / "report.json").read_text())["torn_lines"] == 1
