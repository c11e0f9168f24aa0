"""The recorder on a virtual clock or as a process, a source of a plain signal, and two people
recorded."""

from __future__ import annotations

import csv
import fcntl
import json
import os
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from made_once import made_once

from holdfast.cli.command import Parser
from holdfast.cli.people import add_record_arguments
from holdfast.core.source import SourceReading
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.sessions.recorder.plan import RecordOptions, Task
from holdfast.sessions.recorder.recording import record as record_trials
from holdfast.sessions.recorder.session import Session
from holdfast.sessions.recorder.terminal import Display, Keys, RunContext

PULL = Task("soft-ball", "pull")
TRIAL = "p01/soft-ball/pull/trial_1"
"""Where its first trial is."""
ROOT = Path(__file__).resolve().parents[2]
REST = "virtual://ft232h"
AREA = "What comes from outside"
SCENES = """
[record]
rate_hz = 50
[physics]
step_s = 0.003
[[trials]]
objects = ["soft-ball"]
action = "pull"
close_at_s = 0.8
hold_s = 1.2
tail_s = 0.8
count = 2
[[trials]]
objects = ["soft-ball", "hard-ball"]
action = "pass"
close_at_s = 0.8
hold_s = 1.2
tail_s = 0.8
count = 2
[[trials]]
objects = ["hard-ball"]
action = "fall"
close_at_s = 0.8
hold_s = 1.2
tail_s = 0.8
count = 2
[effects.brush]
count = 3
[effects.dipole]
[effects.hall_noise]
"""
OF_TRIAL = [
    ("soft-ball", "pull"),
    ("soft-ball", "pass"),
    ("hard-ball", "pass"),
    ("hard-ball", "fall"),
] * 2
"""What the trials of that card are."""
PROTOCOL = """
title = "Two objects"
[[trials]]
objects = ["soft-ball", "my-cup"]
action = "pull"
style = "author"
count = 3
[[trials]]
action = "nothing"
count = 2
[objects.my-cup]
mass_g = 212
"""


def never() -> bool:
    return False


def states_in(folder: Path) -> list[str]:
    """The states of the trials with a table, in the order of their paths."""
    tables = sorted(folder.rglob("tactile.csv"))
    return [meta_of(path.parent)["state"] for path in tables]


def errors_in(text: str) -> list[str]:
    """The error lines of what a program printed."""
    return [line for line in text.splitlines() if line.startswith("error: ")]


def options_of(*words: object) -> RecordOptions:
    """What the recorder gets of the words of the verb."""
    parser = Parser(prog="holdfast record")
    add_record_arguments(parser)
    return RecordOptions.of(parser.parse_args([str(one) for one in words]))


def context_of(
    clock: VirtualClock,
    keys: Keys,
    messages: list[str] | None = None,
    **more: Any,
) -> RunContext:
    """A run without a terminal; more: further fields of a RunContext."""
    messages = [] if messages is None else messages
    return RunContext(clock, keys, Display(messages.append), never, **more)


def cup_pull(out: Path) -> list[object]:
    """Words of the verb: the virtual hand at rest, a pull at a cup."""
    argv = f"--source {REST} --person p01 --object cup --action pull"
    return [*argv.split(), "--out", out]


def recorded(
    out: Path, *words: object, source: object = REST, person: str = "p01"
) -> list[str]:
    """One run of the verb on a clock that costs nothing, without a key; its messages."""
    messages: list[str] = []
    options = options_of(
        "--source", source, "--out", out, "--person", person, "--at-once", *words
    )
    clock = VirtualClock(7_000_000_000)
    record_trials(options, context_of(clock, Keys(None), messages))
    return messages


def one_pull(out: Path, *words: object, **where: Any) -> list[str]:
    pull = "--object soft-ball --action pull --trials 1 --seconds 1"
    return recorded(out, *pull.split(), *words, **where)


def meta_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "meta.json").read_text("utf-8")))


def truth_of(folder: Path) -> dict[str, Any]:
    return dict(json.loads((folder / "tactile.truth.json").read_text("utf-8")))


def events_of(folder: Path) -> list[dict[str, Any]]:
    lines = (folder / "events.jsonl").read_text("utf-8").splitlines()
    return [json.loads(line) for line in lines]


def said(messages: Iterable[str], text: str) -> bool:
    """Whether a message holds a text."""
    return any(text in line for line in messages)


def columns_of(folder: Path) -> dict[str, list[str]]:
    with (folder / "tactile.csv").open(newline="") as lines:
        rows = list(csv.DictReader(lines))
    return {name: [row[name] for row in rows] for name in rows[0]}


class Hand:
    """A source of a plain signal: row k after what shifts[k] adds to its stamp, and at row k
    says[k] happens."""

    unit, n_channels, rate_hz = "N", 18, None

    def __init__(
        self,
        n: int,
        *,
        clock: VirtualClock | None = None,
        stalls: Mapping[int, float] | None = None,
        shifts: Mapping[int, float] | None = None,
        says: Mapping[int, Callable[[], object]] | None = None,
    ) -> None:
        self.clock, self.n, self.k = clock or VirtualClock(), n, 0
        self.stalls, self.shifts, self.says = stalls or {}, shifts or {}, says or {}
        self.offset_ns = 0

    def read(self) -> SourceReading | None:
        if self.k == self.n:
            return None
        self.says.get(self.k, never)()
        self.offset_ns += round(1e9 * self.shifts.get(self.k, 0.0))
        t_ns = self.clock.now_ns() + self.offset_ns
        self.clock.spend(round(1e9 * self.stalls.get(self.k, 0.0)))
        values = 0.001 * np.arange(18.0) + (2.0 if 40 <= self.k < 80 else 0.0)
        self.k += 1
        return SourceReading(t_ns, values, np.ones(6, dtype=np.bool_), ("",) * 6)

    def close(self) -> None:
        pass


def session(
    out: Path,
    source: Any,
    tasks: Sequence[Task] = (PULL,),
    keys: Keys | None = None,
    *,
    at_once: bool = True,
    seconds: float | None = None,
    display: Display | None = None,
    host_ns: Callable[[], int] = time.monotonic_ns,
    **more: Any,
) -> tuple[int, list[str]]:
    """A session on any source, at 100 Hz. more: further fields of a Session."""
    messages: list[str] = []
    options = RecordOptions("sim://", out, "p01", seconds=seconds, at_once=at_once)
    display = display or Display(messages.append)
    context = RunContext(source.clock, keys or Keys(None), display, never, host_ns)
    given: dict[str, Any] = {"bias": np.zeros(18), "about": {"unit": "N"}} | more
    return Session(options, context, source, 100.0, **given).run(tasks), messages


@pytest.fixture
def pressing() -> Iterator[tuple[Keys, Callable[[str], None]]]:
    """Keys that are read from a pipe, and what presses them."""
    reading, writing = os.pipe()
    yield Keys(reading), lambda text: void(os.write(writing, text.encode()))
    os.close(reading)
    os.close(writing)


def void(_: object) -> None:
    return None


@pytest.fixture(scope="session")
def card(tmp_path_factory: pytest.TempPathFactory) -> Path:
    path = tmp_path_factory.mktemp("card") / "short.toml"
    path.write_text(SCENES, encoding="utf-8")
    return path


@pytest.fixture(scope="session")
def people(card: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Two people, four trials each, of a scene. Read only."""

    def record(folder: Path) -> None:
        for number, (thing, action) in enumerate(OF_TRIAL):
            words = f"--object {thing} --action {action} --trials 1".split()
            source, person = f"sim://{card}?trial={number}", f"p0{1 + number // 4}"
            recorded(folder / "trials", *words, source=source, person=person)

    return made_once(tmp_path_factory, "recorded", record) / "trials"


class Killed(subprocess.Popen[str]):
    """A process that is killed where the test that waits for it fails."""

    def __exit__(self, kind: Any, *rest: Any) -> None:
        if kind is not None:
            self.kill()
        super().__exit__(kind, *rest)


def start(*words: object, verb: str = "record", **options: Any) -> Killed:
    """A verb as a process; without other options its keys are at their end."""
    command = [sys.executable, "-m", "holdfast", verb, *map(str, words)]
    pipes = {
        "stdin": subprocess.DEVNULL,
        "stdout": subprocess.PIPE,
        "stderr": subprocess.PIPE,
    }
    return Killed(command, cwd=ROOT, text=True, **pipes | options)


def on_terminal(slave: int, *words: object, verb: str = "record") -> Killed:
    """A verb as a process on a terminal of its own; its other side is the test's."""
    run = start(
        *words,
        verb=verb,
        stdin=slave,
        stdout=slave,
        stderr=slave,
        preexec_fn=terminal_of_its_own,
    )
    os.close(slave)
    return run


def wait_for(run: subprocess.Popen[str], word_: str) -> str:
    """The first line of the program's messages with a word; without one, all of them fail."""
    assert run.stderr is not None
    seen = []
    for line in run.stderr:
        if word_ in line:
            return line
        seen.append(line)
    raise AssertionError("".join(seen))


def terminal_of_its_own() -> None:
    """Make stdin the terminal of a new session, as a login does."""
    os.setsid()
    fcntl.ioctl(0, termios.TIOCSCTTY, 0)


def wait_on_terminal_for(master: int, word_: str) -> bytes:
    """Read a terminal's screen until a word is on it."""
    screen = b""
    while word_.encode() not in screen:
        screen += os.read(master, 4096)
    return screen
