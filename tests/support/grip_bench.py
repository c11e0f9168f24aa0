"""Receivers of grip commands, and programs that send some and die."""

from __future__ import annotations

import json
import os
import select
import socket
import subprocess
import sys
import tempfile
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path
from typing import Any

from holdfast.core.contract import GripCommand
from holdfast.core.source import MonotonicClock
from holdfast.edge_runtime.supervisor import last_line, to_line
from holdfast.live.hand_link import HandLink, open_hand_link

ROOT = Path(__file__).resolve().parents[2]
PATIENCE_S = 60.0
"""A receiver waits this long: only a run that never sends anything fails by it."""


class Receiver:
    """Reads lines; those that are not JSON are skipped, as a hand does."""

    def raw(self) -> bytes:
        """The next line as it came, without its line feed."""
        raise NotImplementedError

    def next(self) -> dict[str, Any]:
        while True:
            with suppress(ValueError):
                read: dict[str, Any] = json.loads(self.raw())
                return read

    def until(self, reason: str) -> dict[str, Any]:
        """Read on to a line with this reason."""
        while (line := self.next())["reason"] != reason:
            pass
        return line


class UnixReceiver(Receiver):
    """A socket file of this user."""

    def __init__(self, path: str = "") -> None:
        self.folder = tempfile.TemporaryDirectory()
        self.path = path or f"{self.folder.name}/grip"
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self.socket.bind(self.path)
        self.socket.settimeout(PATIENCE_S)
        self.url = f"unix://{self.path}"
        self._kept: deque[bytes] = deque()

    def keep(self, *_: object) -> None:
        """Wait for a line and keep it for `raw`."""
        self._kept.append(self.socket.recv(65536))

    def raw(self) -> bytes:
        return self._kept.popleft() if self._kept else self.socket.recv(65536)

    def drain(self, *_: object) -> None:
        """Keep what has come: a socket's queue is short."""
        self.socket.setblocking(False)
        with suppress(BlockingIOError):
            while True:
                self._kept.append(self.socket.recv(65536))
        self.socket.settimeout(PATIENCE_S)

    def waiting(self) -> list[dict[str, Any]]:
        """What has already come."""
        self.drain()
        lines = [json.loads(line) for line in self._kept]
        self._kept.clear()
        return lines

    def close(self) -> None:
        self.socket.close()
        Path(self.path).unlink(missing_ok=True)
        self.folder.cleanup()


class TtyReceiver(Receiver):
    """The other end of a serial port."""

    def __init__(self) -> None:
        self.handle, other = os.openpty()
        self.path = os.ttyname(other)
        self.url = f"serial://{self.path}"
        self.other, self._text = other, b""

    def raw(self) -> bytes:
        while b"\n" not in self._text:
            ready, _, _ = select.select([self.handle], [], [], PATIENCE_S)
            assert ready
            self._text += os.read(self.handle, 65536)
        line, _, self._text = self._text.partition(b"\n")
        return line or self.raw()

    def write(self, line: bytes) -> None:
        """Send a line to a program that has opened the port at `path`."""
        os.write(self.handle, line + b"\n")

    def close(self) -> None:
        for handle in (self.handle, self.other):
            if handle >= 0:
                os.close(handle)
        self.handle = self.other = -1


def until(holds: Callable[[], object]) -> None:
    """Wait for what a thread does."""
    end_s = time.monotonic() + PATIENCE_S
    while not holds():
        assert time.monotonic() < end_s
        time.sleep(0.002)


def command(sequence: int, mode: Any = "tighten") -> GripCommand:
    """A command of now."""
    now_ns = MonotonicClock().now_ns()
    return GripCommand(sequence, now_ns, mode, 9.4, 400.0, 0.5, "risky slip")


@contextmanager
def opened(url: str, report: Callable[[str], object] = print) -> Iterator[HandLink]:
    now_ns = MonotonicClock().now_ns
    link = open_hand_link(url, "grip", last_line, report, now_ns)
    reason = "failed"
    try:
        yield link
        reason = "stopped"
    finally:
        link.close(reason)


def send(link: HandLink, *sequences: int) -> None:
    """Commands, each when the one before has left or is lost."""
    for k in sequences:
        link(to_line(command(k)), k)
        until(lambda: link.idle or not link.works)


SENDS_THEN_WAITS = """
import sys
sys.path.insert(0, "tests/support")
from grip_bench import opened, send
with opened(sys.argv[1], lambda text: None) as link:
    send(link, 40, 41, 42)
    print("sent", flush=True)
    sys.stdin.read()
    if sys.argv[2] == "raise":
        raise ValueError("a bug")
"""


@contextmanager
def sender(url: str, then: str = "end") -> Iterator[subprocess.Popen[str]]:
    """A process that has sent three commands and waits for its stdin."""
    program = [sys.executable, "-c", SENDS_THEN_WAITS, url, then]
    with subprocess.Popen(
        program,
        cwd=ROOT,
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        stderr=subprocess.DEVNULL,
        text=True,
        env={**os.environ, "PYTHONPATH": str(ROOT)},
    ) as process:
        assert process.stdout is not None
        process.stdout.readline()
        try:
            yield process
        finally:
            process.kill()
