"""The example receivers do what docs/shared-control.md and docs/shared-control.md say."""

from __future__ import annotations

import importlib.util
import json
import math
import os
import re
import shutil
import signal
import socket
import stat
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import ExitStack, closing, contextmanager
from dataclasses import dataclass
from itertools import count
from pathlib import Path
from threading import Event, Thread, Timer
from typing import Any, NamedTuple

import numpy as np
import pytest
from c_form import SANITIZERS, require_compiler
from grip_bench import ROOT, TtyReceiver, command, opened, send
from hazard_marks import (
    BROKEN_LINE,
    HOLDS_AGAINST_WEARER,
    NO_GRIP_COMMAND,
    OLD_COMMAND,
    OTHER_SENDER,
)
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.hand_lines import RisingRule
from holdfast.core.source import MonotonicClock
from holdfast.edge_runtime.supervisor import to_line
from holdfast.live.cues import QUIET, SILENCE, CueRule, cue_line

EXAMPLES = ROOT / "examples"


STRICT = ["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror"]

LONGEST_S = 20.0
"""A receiver holds after 0.3 s, and a cue receiver after 3 s."""
HOLDS = "hold: the grip it has, at most 0 N/s (no command for 300 ms)"


def compiled(source: Path, made: Path) -> list[str]:
    """A C program, with what finds wrong accesses to memory."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) for examples/grip_receiver.c")
    require_compiler(compiler, *SANITIZERS)
    command = [compiler, *STRICT, *SANITIZERS, "-I", str(EXAMPLES), "-o", str(made)]
    subprocess.run([*command, str(source), "-lm"], check=True, cwd=ROOT)
    return [str(made)]


@pytest.fixture(scope="module", params=["grip_receiver.py", "grip_receiver.c"])
def program(request, tmp_path_factory) -> list[str]:
    source = EXAMPLES / request.param
    if source.suffix == ".py":
        return [sys.executable, str(source)]
    return compiled(source, tmp_path_factory.mktemp("receiver") / "grip_receiver")


class Listening(NamedTuple):
    """The lines that a receiver prints, its URL, and what plays its wearer."""

    lines: Iterator[str]
    url: str
    say: Callable[[str], object]
    process: subprocess.Popen[str]


@contextmanager
def listening(program: list[str], port: str = "") -> Iterator[Listening]:
    """A receiver that runs. port: a serial one; else it listens at a socket of its own."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(port or f"{folder}/hand")
        command = [*program, str(path)]
        pipes: dict[str, Any] = {"stdin": subprocess.PIPE, "stdout": subprocess.PIPE}
        with subprocess.Popen(command, text=True, bufsize=1, **pipes) as process:
            # a receiver that says nothing more ends its lines, and the test fails
            watchdog = Timer(LONGEST_S, process.kill)
            watchdog.start()
            try:
                assert process.stdout is not None
                assert process.stdin is not None
                lines = (line.rstrip("\n") for line in process.stdout)
                assert next(lines) == "listening"
                assert port or stat.S_IMODE(path.stat().st_mode) == 0o600
                url = f"serial://{path}" if port else f"unix://{path}"
                yield Listening(lines, url, process.stdin.write, process)
            finally:
                watchdog.cancel()
                process.kill()


def grip_line(sequence: int, **changed: Any) -> bytes:
    """A command as it is sent."""
    fields = json.loads(to_line(command(sequence))) | changed
    return json.dumps(fields, separators=(",", ":")).encode()


@contextmanager
def sending(url: str) -> Iterator[Callable[[bytes], object]]:
    """Sends what it is given to a receiver."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
        # a receiver's queue is short: this waits until it has room
        sender.connect(url.removeprefix("unix://"))
        yield sender.send


@contextmanager
def repeating(do: Callable[[], object]) -> Iterator[None]:
    """Do it 100 times a second meanwhile, in a thread."""
    ended = Event()

    def repeat() -> None:
        while not ended.wait(0.01):
            do()

    thread = Thread(target=repeat)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def after(lines: Iterator[str], wanted: str) -> str:
    """The line that was wanted, after those of a silence on a slow machine."""
    return next(
        line for line in lines if wanted in line or "no command for" not in line
    )


def test_a_receiver_obeys_commands_and_holds_at_the_end(program):
    with listening(program) as (lines, url, *_):
        with opened(url) as sink:
            send(sink, 1)
            assert (
                after(lines, "tighten")
                == "tighten: 9.4 N, at most 400 N/s (risky slip)"
            )
        assert (
            after(lines, "stopped") == "hold: the grip it has, at most 0 N/s (stopped)"
        )


@NO_GRIP_COMMAND.mark
def test_a_receiver_holds_when_no_command_comes(program):
    with listening(program) as (lines, url, *_), sending(url) as send_line:
        send_line(grip_line(1))
        assert next(lines).startswith("tighten")
        assert next(lines) == HOLDS


SKIPPED = {
    "cut off": grip_line(5)[:60],
    "a number": b"1",
    "a list": b"[]",
    "null": b"null",
    "an empty object": b"{}",
    "2000 brackets": b"[" * 2000,
    "nothing": b"",
    "bytes": bytes(range(256)),
    "no sequence": grip_line(5).replace(b'"sequence"', b'"number"'),
    "NaN": grip_line(5, slew_n_s=math.nan),
    "a force below 0": grip_line(5, target_n=-1.0),
    "true for a sequence": grip_line(5).replace(b":5,", b":true,", 1),
    "text for a force": grip_line(5, target_n="9"),
    "a list for a mode": grip_line(5, mode=[]),
    "an unknown mode": grip_line(5, mode="crush"),
    "a terminal's escape": grip_line(5, reason="\x7f[2J"),
    "a mode that begins well": grip_line(5, mode="hold 5"),
}


@OTHER_SENDER.mark
def test_a_receiver_limits_force_and_speed_itself(program):
    with listening(program) as (lines, url, *_), sending(url) as send_line:
        send_line(grip_line(1, target_n=500.0, slew_n_s=1e9))
        assert next(lines) == "tighten: 70.0 N, at most 400 N/s (risky slip)"


# -- the receivers' rules: the wearer's opening first, then rising sequences until a silence

OFFERS = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 400)), max_size=80)
WORDS = ("stop", "open", "close", "empty")
OPENED, HELD = -2, -1
"""Answers in the tests below; else ten times the target of a command."""


def example(name: str) -> Any:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


now_ns = MonotonicClock().now_ns
GRIP, CUE = example("grip_receiver"), example("cue_receiver")


@given(OFFERS)
def test_the_cue_receiver_has_the_rule_of_the_core(offers):
    own, rule, now_ns = CUE.Rising(), RisingRule(3_000_000_000), 0
    for sequence, later_ms in offers:
        now_ns += 20_000_000 * later_ms
        assert own.obeys(sequence, now_ns) == rule.obeys(now_ns, sequence)


@dataclass(frozen=True)
class Samples:
    """Random samples of a hand's controller: the line that came, the wearer's word, the time, and
    how old the line is. Each list has one entry a sample."""

    lines: list[bytes]
    line: list[int]
    word: list[int]
    ms: list[int]
    age_ms: list[int]

    def offered(self) -> Iterator[Offer]:
        """What a receiver gets."""
        each = zip(self.line, self.word, self.ms, self.age_ms, strict=True)
        for k, word, ms, age_ms in each:
            stamp = b"%d" % (1_000_000 * (ms - age_ms))
            line = self.lines[k].replace(b"@", stamp)
            yield Offer(line, WORDS[word], 1_000_000 * ms)


class Offer(NamedTuple):
    """A line, the wearer's word and the receiver's time."""

    line: bytes
    word: str
    now_ns: int


def random_samples(n: int, seed: int) -> Samples:
    """Commands, rubbish, silences, senders that start again, lines that come late or from another
    clock, and a wearer who opens at any time."""
    draw = np.random.default_rng(seed)
    rubbish = [one for one in SKIPPED.values() if b"\n" not in one and b"\0" not in one]
    lines = [b"", *rubbish]
    for tenths in range(1, 600):
        # numbers go up from line to line, and every hundredth sender begins at 0 again
        whole = grip_line(tenths % 100, target_n=tenths / 10, reason="a", t_ns=0)
        lines.append(whole.replace(b'"t_ns":0,', b'"t_ns":@,'))
    walk = np.cumsum(draw.integers(0, 3, n)) % len(lines)
    line = np.where(draw.random(n) < 0.4, 0, walk)
    changes = draw.random(n) < 0.04
    word = draw.integers(0, len(WORDS), n)[
        np.maximum.accumulate(changes * np.arange(n))
    ]
    pause = draw.random(n) < 0.003
    ms = np.cumsum(np.where(pause, draw.integers(290, 320, n), draw.integers(0, 8, n)))
    ages = draw.integers(0, 20, n)
    strange = draw.random(n) < 0.1
    ages[strange] = draw.integers(-600, 1000, strange.sum())
    ms += 1000
    return Samples(lines, line.tolist(), word.tolist(), ms.tolist(), ages.tolist())


def obeyed(samples: Samples) -> Iterator[int]:
    """What a hand without a wearer does at each sample, by the rule of the core."""
    rule, answer = RisingRule(), HELD
    commands = [HELD] * len(samples.lines)
    for k, line in enumerate(samples.lines[-599:], start=len(samples.lines) - 599):
        commands[k] = round(10 * json.loads(line.replace(b"@", b"0"))["target_n"])
    for k, ms, age_ms in zip(samples.line, samples.ms, samples.age_ms, strict=True):
        if not rule.lives(1_000_000 * ms):
            answer = HELD
        tenths = commands[k] if abs(age_ms) <= 300 else HELD
        if tenths != HELD and rule.obeys(1_000_000 * ms, tenths % 100):
            answer = tenths
        yield answer


def opened_by_the_wearer(samples: Samples, filter_ms: int) -> Iterator[bool]:
    """Whether the hand's own controller has decided to open, at each sample."""
    has_decided, other_ms = False, -filter_ms
    for k, ms in zip(samples.word, samples.ms, strict=True):
        if WORDS[k] != "open":
            other_ms = ms
            has_decided = has_decided and WORDS[k] == "stop"
        elif ms - other_ms >= filter_ms:
            has_decided = True
        yield has_decided


def in_python(
    offers: Iterable[Offer], folder: Path, filter_ms: int = 0, *, is_wire: bool = False
) -> list[int]:
    """What the receiver in Python does at each sample."""
    clock = GRIP.OtherClock() if is_wire else GRIP.SameClock()
    own = GRIP.Receiver(clock, 1_000_000 * filter_ms)
    answers = []
    for offer in offers:
        answer = own.answer(*offer)
        is_command = isinstance(answer[1], float)
        other = OPENED if answer is GRIP.OPEN else HELD
        answers.append(round(10 * answer[1]) if is_command else other)
    return answers


HARNESS_IN_C = """
#define main receiver
#include "grip_receiver.c"
#undef main
int main(int argc, char **argv) {
    static char text[4096];
    receiver_t own = BEGIN;
    own.filter_ns = 1000000LL * atoi(argv[1]);
    own.is_wire = argc > 2;
    while (fgets(text, sizeof text, stdin)) {
        int at;
        char word;
        long long now_ns;
        sscanf(text, "%c %lld |%n", &word, &now_ns, &at);
        text[strcspn(text, "\\n")] = 0;
        const command_t *to = answer(&own, text + at, word, now_ns);
        printf("%d\\n", to == &OPEN ? -2 : to->target_n < 0 ? -1 : (int)(10 * to->target_n + 0.5));
    }
    return 0;
}
"""


def in_c(
    offers: Iterable[Offer], folder: Path, filter_ms: int = 0, *, is_wire: bool = False
) -> list[int]:
    """What the receiver in C does at each sample."""
    (folder / "harness.c").write_text(HARNESS_IN_C, encoding="utf-8")
    program = compiled(folder / "harness.c", folder / "harness")
    text = b"".join(
        b"%c %d |%b\n" % (offer.word[0].encode(), offer.now_ns, offer.line)
        for offer in offers
    )
    command = [*program, str(filter_ms), *["wire"][: int(is_wire)]]
    run = subprocess.run(command, input=text, capture_output=True, check=True)
    return [int(one) for one in run.stdout.split()]


@HOLDS_AGAINST_WEARER.mark
@OTHER_SENDER.mark
@OLD_COMMAND.mark
@BROKEN_LINE.mark
@pytest.mark.parametrize(
    ("receiver", "n", "filter_ms"),
    [
        (in_python, 100_000, 0),
        (in_python, 50_000, 60),
        (in_c, 300_000, 0),
        pytest.param(in_python, 1_000_000, 0, marks=pytest.mark.soak),
    ],
)
def test_no_line_silence_or_restart_delays_an_opening_that_the_hand_has_decided(
    receiver, n, filter_ms, tmp_path
):
    samples = random_samples(n, seed=58)
    answers = receiver(samples.offered(), tmp_path, filter_ms)
    expected = list(obeyed(samples))
    for k, has_decided in enumerate(opened_by_the_wearer(samples, filter_ms)):
        assert answers[k] == (OPENED if has_decided else expected[k]), k
    # each of them came often, or nothing was shown
    seen = Counter(min(one, 0) for one in answers)
    assert min(seen[OPENED], seen[HELD], seen[0]) > n // 200


# -- old lines


class Sent(NamedTuple):
    """A line on a wire: when it was sent and when it came, in s of the receiver's clock."""

    sent_s: float
    came_s: float


LINE_S = 0.018
"""What a line of 210 bytes takes at 115200 baud."""
STEADY = [Sent(k / 50, k / 50 + LINE_S) for k in range(100)]
"""The first two seconds of a wire, at 50 Hz."""


def over_a_wire(
    receiver: Any, wire: list[Sent], folder: Path, clock_s: Callable[[float], float]
) -> list[Sent]:
    """The lines that a receiver obeys. clock_s: what the sender's clock shows at a time."""
    offers = []
    for k, one in enumerate(wire):
        # each target is that of one line only: a wrong one would be another
        line = grip_line(
            k, target_n=k % 600 / 10 + 0.1, t_ns=round(1e9 * clock_s(one.sent_s))
        )
        offers.append(Offer(line, "stop", round(1e9 * one.came_s)))
    answers = receiver(offers, folder, is_wire=True)
    return [one for k, one in enumerate(wire) if answers[k] == k % 600 + 1]


def ahead_s(t_s: float) -> float:
    """A clock that has run for longer than the receiver's."""
    return t_s + 5000.0


RECEIVERS = pytest.mark.parametrize("receiver", [in_python, in_c])


@OLD_COMMAND.mark
@RECEIVERS
def test_what_waited_on_a_wire_for_ten_seconds_is_skipped(receiver, tmp_path):
    waited = [Sent(t_s, 12.0) for t_s in np.arange(2.0, 12.0, 0.02).tolist()]
    fresh = [Sent(one.sent_s + 12.0, one.came_s + 12.0) for one in STEADY]
    heard = over_a_wire(receiver, [*STEADY, *waited, *fresh], tmp_path, ahead_s)
    assert max(one.came_s - one.sent_s for one in heard) < 0.3
    assert [one for one in heard if one.sent_s >= 12.0] == fresh
    # of the first lines those of 300 ms are not obeyed
    assert heard[0].came_s - STEADY[0].came_s == pytest.approx(0.3, abs=0.021)


@OLD_COMMAND.mark
@RECEIVERS
def test_a_wire_that_is_too_slow_for_its_lines_brings_none_that_is_obeyed_late(
    receiver, tmp_path
):
    wire, free_s = [], 0.0
    for t_s in np.arange(0.0, 20.0, 1 / 150).tolist():
        # as fast as lines come, then 4 kB/s, then fast again
        takes_s = 210 / 4000 if 1.0 < t_s < 2.0 else 0.002
        free_s = max(free_s, t_s) + takes_s
        wire.append(Sent(t_s, free_s))
    ages = [one.came_s - one.sent_s for one in wire]
    assert sum(age_s > 0.3 for age_s in ages) > 150
    heard = over_a_wire(receiver, wire, tmp_path, ahead_s)
    assert max(one.came_s - one.sent_s for one in heard) < 0.3
    assert heard[-1] == wire[-1]


@OLD_COMMAND.mark
@RECEIVERS
@pytest.mark.parametrize("drift", [-0.005, 0.005])
def test_clocks_that_part_by_18_s_in_an_hour_let_no_fresh_line_be_skipped(
    receiver, drift, tmp_path
):
    late_s = np.random.default_rng(3).uniform(0.0, 0.05, 3600 * 5)
    wire = [Sent(k / 5, k / 5 + late) for k, late in enumerate(late_s.tolist())]
    heard = over_a_wire(receiver, wire, tmp_path, lambda t_s: (1 + drift) * t_s)
    assert heard == wire[2:]


@OLD_COMMAND.mark
@RECEIVERS
def test_a_sender_whose_clock_begins_anew_is_obeyed_again(receiver, tmp_path):
    later = [Sent(one.sent_s + 60.0, one.came_s + 60.0) for one in STEADY]

    def clock_s(t_s: float) -> float:
        return ahead_s(t_s) if t_s < 60.0 else t_s - 50.0

    heard = over_a_wire(receiver, [*STEADY, *later], tmp_path, clock_s)
    after_s = [one.came_s - later[0].came_s for one in heard if one.came_s > 60.0]
    assert after_s[0] == pytest.approx(0.3, abs=0.021)
    assert heard[-1] == later[-1]


STOPPED_S = [
    pytest.param(0.5, id="half a second"),
    pytest.param(10.0, id="ten seconds", marks=pytest.mark.soak),
]


@OLD_COMMAND.mark
@pytest.mark.parametrize("stopped_s", STOPPED_S)
@pytest.mark.parametrize("link", ["unix", "serial"])
def test_a_receiver_that_was_stopped_obeys_no_line_from_before(
    program, link, stopped_s
):
    with ExitStack() as stack:
        if link == "serial":
            tty = stack.enter_context(closing(TtyReceiver()))
            receiver = stack.enter_context(listening(program, tty.path))
            send_line: Callable[[bytes], object] = tty.write
        else:
            receiver = stack.enter_context(listening(program))
            send_line = stack.enter_context(sending(receiver.url))
        numbers = count()

        def send_until_obeyed(reason: str) -> None:
            """Each of these lines is fresh when it is sent."""
            with repeating(lambda: send_line(grip_line(next(numbers), reason=reason))):
                assert reason in after(receiver.lines, reason)

        send_until_obeyed("before")
        receiver.process.send_signal(signal.SIGSTOP)
        os.waitid(os.P_PID, receiver.process.pid, os.WSTOPPED | os.WNOWAIT)
        for _ in range(5):
            send_line(grip_line(next(numbers), reason="old"))
        time.sleep(stopped_s)
        receiver.process.send_signal(signal.SIGCONT)
        send_until_obeyed("fresh")


@HOLDS_AGAINST_WEARER.mark
def test_a_hand_whose_wearer_opens_ignores_targets_until_the_wearer_closes(program):
    with listening(program) as (lines, url, say, _), sending(url) as send_line:
        send_line(grip_line(1, target_n=8.5))
        assert next(lines).startswith("tighten: 8.5 N")
        say("open\n")
        opens = "open: the wearer's grip, at most 400 N/s (the wearer opens)"
        assert after(lines, "open") == opens
        # more than a socket keeps waiting: the first of them have been read when all are sent
        for k in range(2, 1200):
            send_line(grip_line(k, target_n=9.5 if k < 600 else 10.5))
        say("close\n")
        assert next(lines) in (HOLDS, "tighten: 10.5 N, at most 400 N/s (risky slip)")


def test_each_word_of_the_wearer_counts_however_many_come_at_once(program):
    with listening(program) as (lines, _, say, _):
        say("close\nopen\n")
        assert next(lines).startswith("open")
        say("empty\nstop\n")
        assert next(lines) == HOLDS
        # a word may come in two parts
        say("op")
        say("en\n")
        assert next(lines).startswith("open")


@pytest.fixture(params=["grip_receiver.py", "grip_receiver.c", "cue_receiver.py"])
def receiver_program(request, tmp_path_factory) -> list[str]:
    source = EXAMPLES / request.param
    if source.suffix == ".py":
        return [sys.executable, str(source)]
    return compiled(source, tmp_path_factory.mktemp("receiver") / "grip_receiver")


def test_a_receiver_removes_nothing_but_what_one_that_ended_left(
    receiver_program, tmp_path
):
    note, taken, left = (tmp_path / one for one in ("note", "taken", "left"))
    note.write_text("mine")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as lives:
        lives.bind(str(taken))
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ended:
            ended.bind(str(left))
        too_long = tmp_path / ("x" * 200)
        for path in (note, taken, too_long, tmp_path / "no-folder" / "hand"):
            done = subprocess.run(
                [*receiver_program, str(path)],
                capture_output=True,
                text=True,
                stdin=subprocess.DEVNULL,
                timeout=LONGEST_S,
            )
            assert done.returncode == 1
            assert done.stderr.startswith(str(path))
            assert done.stderr.count("\n") == 1
        assert note.read_text() == "mine"
        assert sorted(tmp_path.iterdir()) == sorted([note, taken, left])
        with subprocess.Popen(
            [*receiver_program, str(left)],
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
        ) as process:
            assert process.stdout is not None
            assert process.stdout.readline() == b"listening\n"
            process.kill()
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender:
            sender.sendto(b"", str(taken))
        assert lives.recv(10) == b""


def test_the_receiver_in_c_reads_numbers_as_they_are_sent_in_every_locale():
    """Where a decimal is a comma, strtod reads 9 of 9.4; such a locale is seldom installed."""
    text = (EXAMPLES / "grip_receiver.c").read_text(encoding="utf-8")
    code = re.sub(r"/\*.*?\*/", "", text, flags=re.DOTALL)
    assert not re.search(r"strtod|atof|%l[efg]", code)


def cue(sequence: int, **changed: Any) -> bytes:
    """An urgent cue as it is sent."""
    act = cue_line(sequence, now_ns(), "act", CueRule(3, 60, 40, 1.0))
    return json.dumps(json.loads(act) | changed).encode()


BROKEN_CUES = [
    b"null",
    b"[]",
    b"[" * 2000,
    cue(1)[:20],
    cue(1, strength=math.nan),
    cue(1, strength=math.inf),
    cue(1, cue=[]),
    cue(1, strength=True),
    cue(1, pulses=10**400),
    cue(1, pulses=-1),
    cue(1, on_ms=True),
    cue(1, cue="\x1b[2J"),
]


@OLD_COMMAND.mark
@BROKEN_LINE.mark
def test_the_cue_receiver_plays_cues_and_skips_signs_of_life_and_what_is_no_cue():
    quiet = cue_line(0, now_ns(), QUIET, SILENCE).encode()
    waited_ns = now_ns() - 3_100_000_000
    old = (cue(500, t_ns=waited_ns), cue(500, t_ns=2**60))
    with (
        listening([sys.executable, str(EXAMPLES / "cue_receiver.py")]) as (
            lines,
            url,
            *_,
        ),
        sending(url) as send_line,
    ):
        whole = cue(600, on_ms=61)
        for line in (*BROKEN_CUES, *old, quiet, cue(0), whole):
            send_line(line)
        assert next(lines) == "act: 3 x 61 ms on, 40 ms off, strength 1"
        assert next(lines) == "link lost: 1 x 1500 ms on, 0 ms off, strength 0.5"
