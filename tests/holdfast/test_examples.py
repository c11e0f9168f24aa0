"""The example receivers do what docs/shared-control.md and docs/feedback.md say."""

from __future__ import annotations

import importlib.util
import json
import math
import random
import shutil
import socket
import stat
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from c_form import SANITIZERS
from grip_bench import ROOT, command, opened, send
from hazard_marks import BROKEN_LINE, NO_GRIP_COMMAND, OTHER_SENDER
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.hand_lines import RisingRule
from holdfast.edge_runtime.supervisor import to_line
from holdfast.live.cues import QUIET, SILENCE, CueRule, cue_line

EXAMPLES = ROOT / "examples"


STRICT = ["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror"]

HOLDS = "hold: the grip it has, at most 0 N/s (no command for 300 ms)"


def compiled(source: Path, made: Path) -> list[str]:
    """A C program, with what finds wrong accesses to memory."""
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) for examples/grip_receiver.c")
    command = [compiler, *STRICT, *SANITIZERS, "-I", str(EXAMPLES), "-o", str(made)]
    subprocess.run([*command, str(source), "-lm"], check=True, cwd=ROOT)
    return [str(made)]


@pytest.fixture(scope="module", params=["grip_receiver.py", "grip_receiver.c"])
def program(request, tmp_path_factory) -> list[str]:
    source = EXAMPLES / request.param
    if source.suffix == ".py":
        return [sys.executable, str(source)]
    return compiled(source, tmp_path_factory.mktemp("receiver") / "grip_receiver")


@contextmanager
def listening(program: list[str]) -> Iterator[tuple[Iterator[str], str]]:
    """(the lines that a receiver prints, its URL)."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "hand"
        command = [*program, str(path)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as process:
            try:
                assert process.stdout is not None
                lines = (line.rstrip("\n") for line in process.stdout)
                assert next(lines) == "listening"
                assert stat.S_IMODE(path.stat().st_mode) == 0o600
                yield lines, f"unix://{path}"
            finally:
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


def after(lines: Iterator[str], wanted: str) -> str:
    """The line that was wanted, after those of a silence on a slow machine."""
    return next(
        line for line in lines if wanted in line or "no command for" not in line
    )


def test_a_receiver_obeys_commands_and_holds_at_the_end(program):
    with listening(program) as (lines, url):
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
    with listening(program) as (lines, url), sending(url) as send_line:
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


@BROKEN_LINE.mark
def test_a_receiver_skips_what_is_no_command(program):
    with listening(program) as (lines, url), sending(url) as send_line:
        for broken in SKIPPED.values():
            send_line(broken)
        send_line(grip_line(6, target_n=8.5))
        assert next(lines) == "tighten: 8.5 N, at most 400 N/s (risky slip)"


@OTHER_SENDER.mark
def test_a_receiver_limits_force_and_speed_itself(program):
    with listening(program) as (lines, url), sending(url) as send_line:
        send_line(grip_line(1, target_n=500.0, slew_n_s=1e9))
        assert next(lines) == "tighten: 70.0 N, at most 400 N/s (risky slip)"


@OTHER_SENDER.mark
def test_an_old_line_moves_nothing(program):
    with listening(program) as (lines, url), sending(url) as send_line:
        for k in range(20):
            send_line(grip_line(k, reason=f"line {k}"))
            send_line(grip_line(0, reason="old", target_n=60.0))
            assert after(lines, f"line {k}")


# -- each receiver has a short form of the rule, which does the same as the rule of the core

OFFERS = st.lists(st.tuples(st.integers(0, 400), st.integers(0, 400)), max_size=80)


def by_the_core(
    offers: list[tuple[int, int]], rule: RisingRule
) -> Iterator[tuple[int, int, bool]]:
    """(sequence, time in ms, whether it is obeyed)."""
    now_ms = 0
    for sequence, later_ms in offers:
        now_ms += later_ms
        yield sequence, now_ms, rule.obeys(1_000_000 * now_ms, sequence)


def example(name: str) -> Any:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


GRIP, CUE = example("grip_receiver"), example("cue_receiver")


@given(OFFERS)
def test_the_grip_receiver_has_the_rule_of_the_core(offers):
    own = GRIP.Rising()
    for sequence, ms, obeyed in by_the_core(offers, RisingRule()):
        assert own.obeys(sequence, 1_000_000 * ms) == obeyed


@given(OFFERS)
def test_the_cue_receiver_has_the_rule_of_the_core(offers):
    own = CUE.Rising()
    slow = [(sequence, 20 * ms) for sequence, ms in offers]
    for sequence, ms, obeyed in by_the_core(slow, RisingRule(3_000_000_000)):
        assert own.obeys(sequence, 1_000_000 * ms) == obeyed


RULE_IN_C = """
#define main receiver
#include "grip_receiver.c"
#undef main
int main(void) {
    rising_t rising = {0, 0, 0};
    long long sequence, ms;
    while (scanf("%lld %lld", &sequence, &ms) == 2)
        printf("%d\\n", obeys(&rising, sequence, 1000000 * ms));
    return 0;
}
"""


def test_the_grip_receiver_in_c_has_the_rule_of_the_core(tmp_path):
    source = tmp_path / "rule.c"
    source.write_text(RULE_IN_C, encoding="utf-8")
    program = compiled(source, tmp_path / "rule")
    draw = random.Random(37)
    offers = [(draw.randrange(400), draw.randrange(330)) for _ in range(20_000)]
    expected = list(by_the_core(offers, RisingRule()))
    asked = "".join(f"{sequence} {ms}\n" for sequence, ms, _ in expected)
    run = subprocess.run(
        program, input=asked, capture_output=True, text=True, check=True
    )
    assert run.stdout.split() == [f"{obeyed:d}" for _, _, obeyed in expected]


def test_the_page_shows_the_receivers_as_they_are():
    page = (ROOT / "docs" / "shared-control.md").read_text("utf-8")
    for name in ("grip_receiver.py", "grip_receiver.c"):
        assert f"(../examples/{name})" in page
        assert Path(EXAMPLES / name).is_file()


def cue(sequence: int, **changed: Any) -> bytes:
    """An urgent cue as it is sent."""
    act = cue_line(sequence, 1, "act", CueRule(3, 60, 40, 1.0))
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


@BROKEN_LINE.mark
def test_the_cue_receiver_plays_cues_and_skips_signs_of_life_and_what_is_no_cue():
    quiet = cue_line(0, 0, QUIET, SILENCE).encode()
    with (
        listening([sys.executable, str(EXAMPLES / "cue_receiver.py")]) as (lines, url),
        sending(url) as send_line,
    ):
        whole = cue(600, on_ms=61)
        for line in (*BROKEN_CUES, quiet, cue(0), whole):
            send_line(line)
        assert next(lines) == "act: 3 x 61 ms on, 40 ms off, strength 1"
        assert next(lines) == "link lost: 1 x 1500 ms on, 0 ms off, strength 0.5"
