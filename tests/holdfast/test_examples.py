"""The example receivers do what docs/shared-control.md and docs/feedback.md say."""

from __future__ import annotations

import importlib.util
import json
import math
import random
import shutil
import stat
import subprocess
import sys
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest
from c_form import SANITIZERS
from grip_bench import ROOT, Hands, command, opened, send, sender
from hazard_marks import BROKEN_LINE, FORGED_LINE, NO_GRIP_COMMAND
from hypothesis import given
from hypothesis import strategies as st
from live_bench import free_port

from holdfast.core.line_key import LinkKey, read_key
from holdfast.core.line_session import LineSender, SessionRule
from holdfast.edge_runtime.supervisor import to_line
from holdfast.live.cues import QUIET, SILENCE, Pattern, cue_line
from holdfast.live.links import open_link

EXAMPLES = ROOT / "examples"


STRICT = ["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror"]
KEY_TEXT = "0123456789abcdef0123456789abcdef"
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


@pytest.fixture
def key(tmp_path) -> LinkKey:
    """A key in a file."""
    path = tmp_path / "link.key"
    path.write_text(f"{KEY_TEXT}\n", encoding="ascii")
    path.chmod(0o600)
    return read_key(path, "grip")


@contextmanager
def listening(
    program: list[str], where: str = "", *more: str
) -> Iterator[tuple[Iterator[str], str]]:
    """(the lines that a receiver prints, its URL). where: a path, or nothing for a port."""
    where = where or str(free_port())
    with subprocess.Popen(
        [*program, where, *more], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            lines = (line.rstrip("\n") for line in process.stdout)
            assert next(lines) == "listening"
            is_path = where.startswith("/")
            yield lines, f"unix://{where}" if is_path else f"udp://127.0.0.1:{where}"
        finally:
            process.kill()


def grip_line(sequence: int, session: int = 4127, **changed: Any) -> bytes:
    """A command as it is sent, without a code."""
    fields = json.loads(to_line(command(sequence))) | changed
    return LineSender(session).line(json.dumps(fields, separators=(",", ":")))


@contextmanager
def sending(url: str) -> Iterator[Callable[[bytes], object]]:
    """Sends what it is given to a receiver."""
    link = open_link(url, "--grip")
    try:
        yield link.write
    finally:
        link.close()


def after(lines: Iterator[str], wanted: str) -> str:
    """The line that was wanted, after those of a silence on a slow machine."""
    return next(
        line for line in lines if wanted in line or "no command for" not in line
    )


def test_a_receiver_obeys_commands_and_holds_at_the_end(program):
    with listening(program) as (lines, url):
        with opened(url, Hands(), []) as sink:
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
    "no session": to_line(command(5)).encode(),
    "Infinity": grip_line(5, target_n=math.inf),
    "NaN": grip_line(5, slew_n_s=math.nan),
    "1e999": grip_line(5).replace(b"9.4", b"1e999"),
    "a force below 0": grip_line(5, target_n=-1.0),
    "a huge whole number": grip_line(5).replace(b"9.4", b"9" * 400),
    "a huge sequence": grip_line(2**53),
    "a huge session": grip_line(5, 2**64),
    "true for a sequence": grip_line(5).replace(b":5,", b":true,", 1),
    "text for a force": grip_line(5, target_n="9"),
    "a list for a mode": grip_line(5, mode=[]),
    "an unknown mode": grip_line(5, mode="crush"),
    "a terminal's escape": grip_line(5, reason="\x7f[2J"),
    "a key twice": grip_line(5).replace(b"9.4,", b'9.4,"target_n":500,'),
    "a key twice, once escaped": grip_line(5)[:-1] + rb',"target_\u006e":500}',
    "a key twice that no receiver reads": grip_line(5, a=1)[:-1] + b',"a":2}',
    "an object inside": grip_line(5, more={"target_n": 500}),
    "a list inside": grip_line(5, more=[{"target_n": 500}]),
    "its force inside": grip_line(5).replace(
        b'"target_n":9.4', b'"a":{"target_n":9.4}'
    ),
    "its force in a text": grip_line(5, reason='"target_n":9').replace(
        b'"target_n"', b'"n"'
    ),
    "a number that is not finite beside": grip_line(5, needed_n=math.inf),
    "a force of 16 as base": grip_line(5).replace(b"9.4", b"0x9"),
    "a force without its end": grip_line(5).replace(b"9.4", b"9."),
    "a force with a zero before": grip_line(5).replace(b"9.4", b"09.4"),
    "a mode that begins well": grip_line(5, mode="hold 5"),
    "a word after the end": grip_line(5) + b"{}",
    "a comma too many": grip_line(5)[:-1] + b",}",
}


@BROKEN_LINE.mark
def test_a_receiver_skips_what_is_no_command(program):
    with listening(program) as (lines, url), sending(url) as send_line:
        for broken in SKIPPED.values():
            send_line(broken)
        spaced = grip_line(6, target_n=8.5).replace(b",", b", ").replace(b":", b" : ")
        send_line(spaced)
        assert next(lines) == "tighten: 8.5 N, at most 400 N/s (risky slip)"


@FORGED_LINE.mark
def test_a_receiver_limits_force_and_speed_itself(program):
    with listening(program) as (lines, url), sending(url) as send_line:
        send_line(grip_line(1, target_n=500.0, slew_n_s=1e9))
        assert next(lines) == "tighten: 70.0 N, at most 400 N/s (risky slip)"


@FORGED_LINE.mark
def test_one_forged_line_neither_moves_the_hand_nor_takes_it(program):
    forged = [
        grip_line(1, 666, t_ns=9223372036854775806, target_n=500.0),
        grip_line(2**53 - 1, t_ns=9223372036854775806, target_n=500.0),
        grip_line(2, 4128),
    ]
    with listening(program) as (lines, url), sending(url) as send_line:
        for k in range(20):
            send_line(grip_line(k))
            for line in forged:
                send_line(line)
        send_line(grip_line(20, reason="stopped"))
        came = [after(lines, "tighten") for _ in range(21)]
    assert came[:20] == ["tighten: 9.4 N, at most 400 N/s (risky slip)"] * 20
    assert came[20].endswith("(stopped)")


@FORGED_LINE.mark
def test_a_receiver_with_a_key_obeys_sealed_lines_once_and_remembers_the_session(
    program, key
):
    other = LinkKey(b"f" * 32, "grip")
    old = [key.sealed(grip_line(k, 5)) for k in range(3)]
    for session, expected in ((6, "first"), (7, "second")):
        with (
            listening(program, "", str(key.path)) as (lines, url),
            sending(url) as send_line,
        ):
            send_line(grip_line(1, 9))
            send_line(other.sealed(grip_line(1, 9)))
            send_line(LinkKey(key.key, "feedback").sealed(grip_line(1, 9)))
            send_line(key.sealed(grip_line(1, 9))[:-3] + b'0"}')
            # before the first restart no session has ever been obeyed
            if expected == "second":
                for line in old:
                    send_line(line)
            new = key.sealed(grip_line(1, session, reason=expected))
            send_line(new)
            send_line(new)
            assert next(lines).endswith(f"({expected})")
            assert next(lines) == HOLDS
            send_line(new)
            send_line(key.sealed(grip_line(2, session, reason="last")))
            assert next(lines).endswith("(last)")
        assert key.newest_seen() == session


@FORGED_LINE.mark
def test_a_run_with_a_key_and_its_guardian_are_obeyed_over_a_unix_socket(
    program, key, tmp_path
):
    path = tmp_path / "grip"
    with listening(program, str(path), str(key.path)) as (lines, url):
        assert stat.S_IMODE(path.stat().st_mode) == 0o600
        with sender(f"{url}?key={key.path}") as (process, _):
            assert next(lines).startswith("tighten")
            process.kill()
            assert next(line for line in lines if "process died" in line)


# -- each receiver has a short form of the rule, which does the same as the rule of the core

OFFERS = st.lists(
    st.tuples(st.integers(0, 3), st.integers(0, 400), st.integers(0, 400)), max_size=80
)


def by_the_core(
    offers: list[tuple[int, int, int]], rule: SessionRule
) -> Iterator[tuple[int, int, int, bool]]:
    """(session, sequence, time in ms, whether it is obeyed)."""
    now_ms = 0
    for session, sequence, later_ms in offers:
        now_ms += later_ms
        fits = not rule.refusal(session, sequence, 1_000_000 * now_ms)
        if fits:
            rule.obeyed(session, sequence, 1_000_000 * now_ms)
        yield session, sequence, now_ms, fits


def example(name: str) -> Any:
    """An example as a module."""
    spec = importlib.util.spec_from_file_location(name, EXAMPLES / f"{name}.py")
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


GRIP, CUE = example("grip_receiver"), example("cue_receiver")


@given(OFFERS, st.booleans())
def test_the_grip_receiver_has_the_rule_of_the_core(offers, keyed):
    after = (1, 100) if keyed else None
    own = GRIP.Session(after)
    for session, sequence, ms, fits in by_the_core(
        offers, SessionRule(150, after=after)
    ):
        assert own.obeys(session, sequence, 1_000_000 * ms) == fits


@given(OFFERS)
def test_the_cue_receiver_has_the_rule_of_the_core(offers):
    own, rule = CUE.Session(), SessionRule(600, 3_000_000_000)
    slow = [(session, 3 * sequence, 20 * ms) for session, sequence, ms in offers]
    for session, sequence, ms, fits in by_the_core(slow, rule):
        assert own.obeys(session, sequence, 1_000_000 * ms) == fits


RULE_IN_C = """
#define main receiver
#include "grip_receiver.c"
#undef main
int main(void) {
    session_t plain = {0, -1, 0, 0, 0}, keyed = {1, 100, 0, 1, 0};
    long long session, sequence, ms;
    while (scanf("%lld %lld %lld", &session, &sequence, &ms) == 3) {
        const int fits = obeys(&plain, session, sequence, 1000000 * ms);
        printf("%d %d\\n", fits, obeys(&keyed, session, sequence, 1000000 * ms));
    }
    return 0;
}
"""


def test_the_grip_receiver_in_c_has_the_rule_of_the_core(tmp_path):
    source = tmp_path / "rule.c"
    source.write_text(RULE_IN_C, encoding="utf-8")
    program = compiled(source, tmp_path / "rule")
    draw = random.Random(37)
    offers = [
        (draw.choice((1, 1, 1, 2, 3)), draw.randrange(400), draw.randrange(330))
        for _ in range(20_000)
    ]
    plain = list(by_the_core(offers, SessionRule(150)))
    keyed = list(by_the_core(offers, SessionRule(150, after=(1, 100))))
    asked = "".join(f"{one[0]} {one[1]} {one[2]}\n" for one in plain)
    run = subprocess.run(
        program, input=asked, capture_output=True, text=True, check=True
    )
    expected = [f"{a[3]:d} {b[3]:d}" for a, b in zip(plain, keyed, strict=True)]
    assert run.stdout.splitlines() == expected
    assert {"0 0", "1 0", "1 1"} <= set(expected)


CODE_IN_C = f"""
#include <stdio.h>
#include "hmac_sha256.h"
int main(void) {{
    char text[2000];
    uint8_t code[32];
    hmac_sha256("{KEY_TEXT}", "grip\\n", text, fread(text, 1, sizeof text, stdin), code);
    for (int k = 0; k < 32; ++k) printf("%02x", code[k]);
    return 0;
}}
"""


@pytest.fixture(scope="module")
def coded(tmp_path_factory) -> list[str]:
    """A program that prints the code of its input."""
    folder = tmp_path_factory.mktemp("code")
    (folder / "code.c").write_text(CODE_IN_C, encoding="utf-8")
    return compiled(folder / "code.c", folder / "code")


@pytest.mark.parametrize("size", [0, 1, 54, 55, 56, 63, 64, 119, 120, 1000])
def test_a_line_of_any_length_has_the_same_code_in_c(size, coded):
    text = ("ab" * size)[:size]
    run = subprocess.run(coded, input=text, capture_output=True, text=True, check=True)
    assert run.stdout.encode() == LinkKey(KEY_TEXT.encode(), "grip").code(text.encode())


def test_the_page_shows_the_receivers_as_they_are():
    page = (ROOT / "docs" / "shared-control.md").read_text("utf-8")
    for name in ("grip_receiver.py", "grip_receiver.c"):
        assert f"(../examples/{name})" in page
        assert Path(EXAMPLES / name).is_file()


def cue(sequence: int, session: int = 4127, **changed: Any) -> bytes:
    """An urgent cue as it is sent."""
    act = cue_line(sequence, 1, "act", Pattern(3, 60, 40, 1.0))
    return LineSender(session).line(json.dumps(json.loads(act) | changed))


BROKEN_CUES = (
    [line for name, line in SKIPPED.items() if line[:10] != grip_line(5)[:10]]
    + [
        cue(1)[:20],
        cue(1, strength=math.nan),
        cue(1, strength=math.inf),
        cue(1, cue=[]),
        cue(1, strength=True),
        cue(1, more={"pulses": 1}),
        cue(1)[:-1] + b',"pulses":5}',
    ]
    + [
        cue(1, pulses=10**400),
        cue(1, pulses=-1),
        cue(1, on_ms=True),
        cue(1, cue="\x1b[2J"),
    ]
)


@BROKEN_LINE.mark
@FORGED_LINE.mark
def test_the_cue_receiver_plays_cues_and_skips_signs_of_life_and_what_is_no_cue():
    quiet = LineSender(4127).line(cue_line(0, 0, QUIET, SILENCE))
    with (
        listening([sys.executable, str(EXAMPLES / "cue_receiver.py")]) as (lines, url),
        sending(url) as send_line,
    ):
        whole = cue(600, on_ms=61)
        for line in (*BROKEN_CUES, quiet, cue(1, 666), cue(0), cue(601), whole):
            send_line(line)
        assert next(lines) == "act: 3 x 61 ms on, 40 ms off, strength 1"
        assert next(lines) == "link lost: 1 x 1500 ms on, 0 ms off, strength 0.5"
