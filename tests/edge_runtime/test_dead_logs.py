"""A log that takes nothing any more costs its lines and nothing else: terminals, pipes, files,
disks."""

from __future__ import annotations

import fcntl
import json
import os
import pty
import resource
import select
import signal
import socket
import subprocess
import sys
import termios
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from typing import Any

import pytest
from grip_bench import until
from hazard_marks import DEAD_LOG
from hypothesis import given, settings
from hypothesis import strategies as st
from live_bench import ROOT, RUN, Steady, go

from holdfast.core.contract import Prediction
from holdfast.core.lines import STREAM_LINES, LineWriter, Sink, stream_sink
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.monitor import Model
from holdfast.live.outputs import LineOutput

LINE = "x" * 800
LONG_S = 300.0
"""A test that waits so long has found a hang."""
Pair = tuple[int, int]
Running = tuple["subprocess.Popen[str]", Callable[[int], None]]


@pytest.fixture(scope="module")
def prediction(model: Model) -> Prediction:
    clock = VirtualClock()
    return go(model, Steady(clock, 1), clock)[1][0]


@pytest.fixture
def terminal() -> Iterator[Pair]:
    """(what a person sees, what a program writes to); it is read only if a test reads it."""
    yield from _pair(pty.openpty())


@pytest.fixture
def pipe() -> Iterator[Pair]:
    """(read, write)."""
    yield from _pair(os.pipe())


def _pair(ends: Pair) -> Iterator[Pair]:
    yield ends
    for end in ends:
        os.close(end)


def sink_on(handle: int) -> Sink:
    with open(handle, "w", encoding="utf-8", closefd=False) as stream:
        return stream_sink(stream, "stdout")


def read_until(handle: int, word: bytes) -> bytes:
    """All that comes until the word has come."""
    taken = b""
    while word not in taken:
        more = os.read(handle, 1 << 16)
        assert more, "it ended before"
        taken += more
    return taken


def read_to_end(handle: int) -> bytes:
    """All of a pipe whose writers have closed it."""
    return b"".join(iter(lambda: os.read(handle, 1 << 16), b""))


class Lines(list[str]):
    """A sink that works until a test makes it fail."""

    name, dropped = "grip", 0
    failure: OSError | None = None

    def __call__(self, line: str) -> bool:
        self.append(line)
        return True

    def end(self) -> None:
        pass

    def close(self, wait_s: float = 0.0) -> None:
        pass


# -- what takes nothing, for a while


@DEAD_LOG.mark
def test_a_stopped_terminal_goes_on_with_the_newest_lines(terminal):
    termios.tcflow(terminal[1], termios.TCOOFF)  # as ^S
    sink = sink_on(terminal[1])
    for k in range(2 * STREAM_LINES):
        sink(str(k))
    termios.tcflow(terminal[1], termios.TCOON)
    numbers = [
        int(line)
        for line in read_until(
            terminal[0], f"\n{2 * STREAM_LINES - 1}\r\n".encode()
        ).split()
    ]
    sink.close(LONG_S)
    assert numbers[-STREAM_LINES:] == list(range(STREAM_LINES, 2 * STREAM_LINES))
    assert sink.dropped == 2 * STREAM_LINES - len(numbers)


def _all_there(handle: int) -> bytes:
    taken = b""
    try:
        while more := os.read(handle, 1 << 16):
            taken += more
    except BlockingIOError:
        pass
    return taken


@DEAD_LOG.mark
@settings(max_examples=25)
@given(
    st.lists(
        st.one_of(st.text(alphabet="abcä", max_size=9000), st.just(None)), max_size=12
    ),
    st.booleans(),
)
def test_whatever_is_written_and_read_in_whatever_order_lines_arrive_whole_or_not_at_all(
    steps, blocking
):
    read, write = os.pipe()
    fcntl.fcntl(write, fcntl.F_SETPIPE_SZ, 4096)
    os.set_blocking(
        write, blocking
    )  # a shell may hand down a descriptor that does not block
    writer = LineWriter(write)
    offered = [f"{k} {step}" for k, step in enumerate(steps) if step is not None]
    os.set_blocking(read, False)
    kept, lines = b"", iter(offered)
    for step in steps:
        if step is None:
            kept += _all_there(read)
        else:
            writer(next(lines))
    writer.end()
    os.set_blocking(read, True)
    kept += read_to_end(read)
    writer.close(LONG_S)
    os.close(read)
    assert kept.decode() == "".join(f"{line}\n" for line in offered)
    assert (writer.offered, writer.dropped) == (len(offered), 0)


@DEAD_LOG.mark
def test_closing_leaves_a_write_that_takes_for_ever_behind_and_nothing_follows_its_line(
    pipe,
):
    writer = LineWriter(os.dup(pipe[1]))
    until(lambda: not writer(LINE))
    until(lambda: not select.select([], [pipe[1]], [], 0)[1])
    writer.close()  # returns, or this test hangs
    writer.close()
    assert not writer("after the end")
    os.dup2(pipe[0], pipe[1])  # closed, and the number is still ours
    lines = read_to_end(pipe[0]).decode().splitlines(keepends=True)
    assert set(lines) == {LINE + "\n"}
    assert writer.dropped == writer.offered - writer.written > 0


# -- what fails


def failing(name: str) -> tuple[Sink, str]:
    """A sink that fails at its first line, and the reason."""
    if name == "full disk":
        return sink_on(os.open("/dev/full", os.O_WRONLY)), "No space left on device"
    if name == "closed descriptor":
        return sink_on(os.open(os.devnull, os.O_RDONLY)), "Bad file descriptor"
    ends = pty.openpty() if name == "closed terminal" else os.pipe()
    sink = sink_on(ends[1])
    for end in ends:
        os.close(end)
    return sink, "Input/output error" if name == "closed terminal" else "Broken pipe"


@DEAD_LOG.mark
@pytest.mark.parametrize(
    "name", ["full disk", "closed descriptor", "closed terminal", "closed pipe"]
)
def test_a_log_that_fails_is_dropped_and_reported_once_and_the_others_get_every_line(
    name, prediction
):
    log, why = failing(name)
    result: list[str] = []
    outlets = LineOutput([log, healthy := Lines()], result.append)
    outlets.write(prediction)
    until(lambda: log.failure is not None)
    for _ in range(5):
        outlets.write(prediction)
    outlets.close()
    assert len(healthy) == 6
    assert result == [
        f"stdout takes no more lines ({why}); it is dropped, control goes on"
    ]
    assert outlets.failures.keys() == {"stdout"}
    assert 1 <= outlets.dropped <= 2


# -- whole programs


@contextmanager
def running(
    words: Sequence[str] = (), redirect: str = "", **options: Any
) -> Iterator[Running]:
    """holdfast run as a process of its own, and what waits for its n-th answer at the controller's
    port."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as controller:
        controller.bind(("127.0.0.1", 0))
        controller.settimeout(LONG_S)
        port = controller.getsockname()[1]
        run = [
            *RUN,
        ]

        def answered(n: int) -> None:
            while json.loads(controller.recv(65536))["sequence"] < n:
                pass

        command = [
            "sh",
            "-c",
            f'exec "$@" {redirect}',
            "sh",
            *run,
            "--to",
            f"udp://127.0.0.1:{port}",
            "--to",
            "-",
            *words,
        ]
        with subprocess.Popen(
            command, cwd=ROOT, text=True, env=os.environ | {"TERM": "xterm"}, **options
        ) as process:
            try:
                yield process, answered
            finally:
                process.kill()


@DEAD_LOG.mark
def test_a_run_with_lines_and_view_on_a_terminal_that_is_not_drained_still_ends_at_sigterm(
    terminal,
):
    os.set_blocking(terminal[1], False)
    while _fills(terminal[1]):
        pass
    os.set_blocking(terminal[1], True)
    with running(
        ["--to", "view"], stdin=terminal[1], stdout=terminal[1], stderr=terminal[1]
    ) as (
        process,
        answered,
    ):
        answered(30)
        process.send_signal(signal.SIGTERM)
        assert process.wait(LONG_S) == 0


def _fills(handle: int) -> bool:
    try:
        return os.write(handle, b"x" * 64) > 0
    except BlockingIOError:
        return False


@DEAD_LOG.mark
def test_a_run_in_the_background_of_a_terminal_that_stops_such_output_is_not_stopped(
    terminal,
):
    attributes = termios.tcgetattr(terminal[1])
    attributes[3] |= termios.TOSTOP
    termios.tcsetattr(terminal[1], termios.TCSANOW, attributes)

    def with_a_terminal_of_its_own() -> None:
        os.setsid()
        fcntl.ioctl(terminal[1], termios.TIOCSCTTY, 0)

    run = [
        *RUN,
        "--seconds",
        "0.2",
    ]
    with subprocess.Popen(
        ["sh", "-c", 'set -m; "$@" & wait $!', "sh", *run],
        cwd=ROOT,
        preexec_fn=with_a_terminal_of_its_own,
        stdin=terminal[1],
        stdout=terminal[1],
        stderr=terminal[1],
    ) as shell:
        try:
            assert b"read to emit" in read_until(terminal[0], b"read to emit")
            assert shell.wait(LONG_S) == 0
        finally:
            shell.kill()


def limit_files() -> None:
    """In a child: as a disk that is full after 20 kB."""
    resource.setrlimit(resource.RLIMIT_FSIZE, (20_000, 20_000))


@DEAD_LOG.mark
def test_a_run_whose_stdout_is_closed_and_whose_disk_is_full_controls_on_and_says_what_it_lost(
    tmp_path,
):
    words = [
        "--to",
        str(tmp_path / "out.jsonl"),
        "--to",
        str(tmp_path / "kept.csv"),
        "--to",
        f"answers:{tmp_path / 'table.csv'}",
    ]
    read, write = os.pipe()
    os.close(read)
    with running(
        words, stdout=write, stderr=subprocess.PIPE, preexec_fn=limit_files
    ) as (
        process,
        answered,
    ):
        os.close(write)
        # a row of the table is short: 20 kB hold some 500
        answered(900)
        process.send_signal(signal.SIGTERM)
        _, err = process.communicate(timeout=LONG_S)
    for name, why in (
        ("stdout", "Broken pipe"),
        (tmp_path / "out.jsonl", "File too large"),
        (tmp_path / "kept.csv", "File too large"),
        (tmp_path / "table.csv", "File too large"),
    ):
        assert [
            why in line for line in err.splitlines() if line.startswith(f"{name}")
        ] == [True]
        assert (
            len([line for line in err.splitlines() if line.startswith(f"lost: {name}")])
            == 1
        )
    assert all(
        json.loads(line)["state"]
        for line in (tmp_path / "out.jsonl").read_text().splitlines()
    )
    for name in ("kept.csv", "table.csv"):
        assert (tmp_path / name).read_text().endswith("\n")
    assert process.returncode == 5, "the files are not whole"


@DEAD_LOG.mark
def test_a_run_whose_stdout_is_closed_from_the_start_and_whose_stderr_is_full_controls_on():
    with running(redirect=">&- 2>/dev/full") as (process, answered):
        answered(30)
        process.send_signal(signal.SIGTERM)
        assert process.wait(LONG_S) == 5


@pytest.mark.parametrize("dead", ["2>&-", "2>/dev/full", "2>&1 >/dev/full"])
def test_an_error_that_no_stderr_takes_leaves_the_exit_code_as_it_is(dead):
    done = subprocess.run(
        ["sh", "-c", f"exec {sys.executable} -m holdfast nonsense {dead}"],
        cwd=ROOT,
        capture_output=True,
        text=True,
        check=False,
        timeout=LONG_S,
    )
    assert done.returncode == 2
    assert "Traceback" not in done.stdout + done.stderr
