"""The example receivers do what docs/shared-control.md and docs/feedback.md say."""

from __future__ import annotations

import shutil
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import pytest
from grip_bench import ROOT, Hands, command, opened, send
from live_bench import free_port

from holdfast.edge_runtime.supervisor import to_line
from holdfast.live.cues import QUIET, SILENCE, Pattern, cue_line
from holdfast.live.links import open_link

EXAMPLES = ROOT / "examples"


@pytest.fixture(scope="module", params=["grip_receiver.py", "grip_receiver.c"])
def program(request, tmp_path_factory) -> list[str]:
    source = EXAMPLES / request.param
    if source.suffix == ".py":
        return [sys.executable, str(source)]
    compiler = shutil.which("cc")
    if compiler is None:
        pytest.skip("no C compiler (cc) for examples/grip_receiver.c")
    made = tmp_path_factory.mktemp("receiver") / "grip_receiver"
    strict = ["-std=c99", "-D_POSIX_C_SOURCE=200809L", "-Wall", "-Wextra", "-Werror"]
    subprocess.run(
        [compiler, *strict, "-o", str(made), str(source)], check=True, cwd=ROOT
    )
    return [str(made)]


@contextmanager
def listening(program: list[str]) -> Iterator[tuple[Iterator[str], str]]:
    """(the lines that a receiver prints, its URL)."""
    port = free_port()
    with subprocess.Popen(
        [*program, str(port)], stdout=subprocess.PIPE, text=True
    ) as process:
        try:
            assert process.stdout is not None
            lines = (line.rstrip("\n") for line in process.stdout)
            assert next(lines) == "listening"
            yield lines, f"udp://127.0.0.1:{port}"
        finally:
            process.kill()


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


def test_a_receiver_holds_when_no_command_comes(program):
    with listening(program) as (lines, url):
        link = open_link(url, "--grip")
        link.write(to_line(command(1)).encode())
        assert next(lines).startswith("tighten")
        assert (
            next(lines)
            == "hold: the grip it has, at most 0 N/s (no command for 300 ms)"
        )
        link.close()


def test_a_receiver_skips_what_was_cut_off(program):
    with listening(program) as (lines, url):
        link = open_link(url, "--grip")
        whole = to_line(command(5)).encode()
        link.write(whole[: len(whole) // 3])
        link.write(whole)
        assert next(lines).startswith("tighten: 9.4 N")
        link.close()


def test_the_page_shows_the_receivers_as_they_are():
    page = (ROOT / "docs" / "shared-control.md").read_text("utf-8")
    for name in ("grip_receiver.py", "grip_receiver.c"):
        assert f"(../examples/{name})" in page
        assert Path(EXAMPLES / name).is_file()


def test_the_cue_receiver_plays_cues_and_skips_signs_of_life():
    act = cue_line(1, 1, "act", Pattern(3, 60, 40, 1.0))
    with listening([sys.executable, str(EXAMPLES / "cue_receiver.py")]) as (lines, url):
        link = open_link(url, "--feedback")
        for line in (cue_line(0, 0, QUIET, SILENCE), act[:20], act):
            link.write(line.encode())
        link.close()
        assert next(lines) == "act: 3 x 60 ms on, 40 ms off, strength 1"
        assert next(lines) == "link lost: 1 x 1500 ms on, 0 ms off, strength 0.5"
