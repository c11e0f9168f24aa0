"""Lines to and from a hand: one JSON object each, over a Unix socket or a serial port.

    {"sequence":812,"t_ns":5413333333,"mode":"tighten","target_n":9.4}

`sequence` rises from line to line. A receiver

1. skips what is not one JSON object that it understands;
2. obeys a line only where its sequence is above that of the line before;
3. holds where it has obeyed no line for 300 ms (SILENCE_NS); then any sequence may begin, as after
   a restart of the sender;
4. obeys no line that is older than 300 ms (`expires_ms`), by its `t_ns`: what waits in a socket or
   a wire while its reader is stopped or slow is old when it is read. docs/shared-control.md says
   how a receiver with another clock finds the age.

A line without a sequence is obeyed as it comes. Nothing that moves a hand crosses a network: the
file of a Unix socket has permissions 0600, so only processes of the same user may write to it.
"""

from __future__ import annotations

import os
import socket
import stat
from collections import Counter
from collections.abc import Callable
from contextlib import ExitStack, suppress
from pathlib import Path

from holdfast.core.contract import Json
from holdfast.core.errors import UsageError, visible
from holdfast.core.schema import message_of

SILENCE_NS = 300_000_000
"""A sender that has been silent for longer is gone."""
LONGEST_LINE = 16 << 10
"""Bytes. A sample of 64 sensors needs 5,000."""
MOST_A_CALL = 32
"""Datagrams that are read at a call, so that a fast sender delays lines and no sample."""
LONGEST_SHOWN = 80
SECOND_NS = 1_000_000_000

NOT_UNDERSTOOD, NOT_RISING = "not understood", "not rising"


class LineRefused(ValueError):
    """A line that is skipped. kind: one of the words above, to count by."""

    def __init__(self, kind: str, why: str = "") -> None:
        self.kind = kind
        super().__init__(f"{kind} ({why})" if why else kind)


def fields_of(line: bytes) -> Json:
    """The members of a line that is one JSON object; numbers may be nan or infinite.

    Raises ValueError, with the reason.
    """
    if len(line) > LONGEST_LINE:
        raise ValueError("too long")
    fields = message_of(line)
    if not isinstance(fields, dict):
        raise ValueError("no JSON object")
    return fields


def sequence_of(value: object) -> int | None:
    """The sequence of a line; None where it has none. Raises ValueError."""
    # in Python, true is an int
    if value is not None and (type(value) is not int or value < 0):
        raise ValueError("its sequence is no whole number from 0 on")
    return value


def printable(line: bytes) -> str:
    """The beginning of a line as text, with escapes for what does not print."""
    return visible(line[:LONGEST_SHOWN].decode(errors="replace"))


class RisingRule:
    """Whether a line counts. It has no clock: every call brings the time."""

    def __init__(self, silence_ns: int = SILENCE_NS) -> None:
        self._silence_ns = silence_ns
        self._newest: tuple[int | None, ...] = ()
        self._obeyed_ns: int | None = None

    def lives(self, now_ns: int) -> bool:
        """Whether a line counted in the last `silence_ns`."""
        obeyed_ns = self._obeyed_ns
        return obeyed_ns is not None and now_ns - obeyed_ns <= self._silence_ns

    def obeys(self, now_ns: int, *numbers: int | None) -> bool:
        """Whether a line counts; it is then the newest.

        numbers: each must be above that of the line before, where both have it.
        """
        if self.lives(now_ns):
            for number, before in zip(numbers, self._newest, strict=True):
                if number is not None and before is not None and number <= before:
                    return False
        self._newest = numbers
        self._obeyed_ns = now_ns
        return True


class SkippedLines:
    """Counts what is skipped, and says so at most once a second: a log must not fill.

    name: what the lines of the report begin with, such as "commands". total: by kind.
    """

    def __init__(
        self, name: str, report: Callable[[str], object], now_ns: Callable[[], int]
    ) -> None:
        self._name = name
        self._report = report
        self._now_ns = now_ns
        self._said_ns = -SECOND_NS
        self.total: Counter[str] = Counter()

    def count(self, kind: str, shown: str, n: int = 1) -> None:
        """`n` more. kind: one of a few words; shown: these, for the report."""
        self.total[kind] += n
        now_ns = self._now_ns()
        if now_ns - self._said_ns >= SECOND_NS:
            self._report(f"{self._name}: {shown}")
            self._said_ns = now_ns

    def close(self) -> None:
        """Report how many there were in all."""
        if self.total:
            self._report(f"{self._name}: {self.total.total():,} skipped in all")


# -- where lines go and come from


def not_an_address(url: str, link: str, cause: str = "") -> UsageError:
    """The error for a URL at which no lines for a hand may come."""
    if url.startswith(("udp://", "tcp://")):
        cause = "nothing that moves a hand crosses a network"
    return UsageError(
        f"{link}: {url[:80]!r} is not an address",
        cause=cause,
        next_step=f"unix:///run/holdfast/{link}",
    )


def unix_listener(path: Path, link: str, stack: ExitStack) -> socket.socket:
    """A socket that datagrams come to, closed with the stack. Raises UsageError."""
    try:
        listener = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
        _remove_left_behind(path)
        # before bind: the file never has wider permissions than these, whatever the umask
        os.fchmod(listener.fileno(), stat.S_IRUSR | stat.S_IWUSR)
        listener.bind(str(path))
        # a sample never waits for a line
        listener.setblocking(False)
    except (OSError, ValueError) as error:
        what = (error.strerror if isinstance(error, OSError) else "") or str(error)
        raise UsageError(
            f"{link}: cannot listen at unix://{path}: {what}",
            next_step="choose another path",
        ) from None
    stack.callback(path.unlink, missing_ok=True)
    return listener


def _remove_left_behind(path: Path) -> None:
    """Remove the socket file of a program that ended; leave anything else. Raises OSError."""
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
