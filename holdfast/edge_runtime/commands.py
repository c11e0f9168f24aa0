"""Commands of the wearer's control, as datagrams: {"opening": true}, {"override": true}.

opening lasts until a datagram takes it back, or until no datagram has come for EXPIRES_NS. So a
sender repeats its command, or sends {} to show that it is still there. override counts for the
sample at which it came; the decision (edge_runtime/decision.py) sets how long it then lasts. At
most MOST_A_SAMPLE datagrams are read at one sample: a flooded port delays commands, but no sample.
Commands have a log of their own.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from holdfast.core.contract import CommandLink
from holdfast.core.errors import UsageError
from holdfast.core.reading import json_of

LONGEST = 1024
"""Bytes of a datagram; what is longer is cut and not understood."""
MOST_A_SAMPLE = 32
KEYS = {"opening", "override"}
EXPIRES_NS = 300_000_000
"""The command of a sender that has been silent for longer expires."""


@dataclass(frozen=True)
class Command:
    """What the wearer commands at a sample.

    opening ends an act and prevents a new one; override ends every request and blocks new ones for
    a while. link: whether commands have come at all, and whether they still come.
    """

    opening: bool = False
    override: bool = False
    link: CommandLink = "none"


@contextmanager
def command_port(
    address: str, log: Callable[[str], None], now_ns: Callable[[], int]
) -> Iterator[Callable[[], Command]]:
    """Listen on HOST:PORT. The function that it yields is called once a sample and never waits.

    log: receives one line for each datagram that changes something or is not understood, and for a
    sender that goes silent. now_ns: monotonic. Raises UsageError where it cannot listen on the
    port.
    """
    with receiving(address) as receiver:
        yield _Listener(receiver, log, now_ns).ask


@contextmanager
def receiving(address: str) -> Iterator[socket.socket]:
    """A socket that receives datagrams at HOST:PORT, and never waits. Raises UsageError."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise UsageError(
            f"{address!r} is not an address",
            next_step="give HOST:PORT, such as 127.0.0.1:9001",
        )

    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind((host, int(port)))
        except (OSError, OverflowError, ValueError) as error:
            raise UsageError(
                f"{address!r}: {error}", next_step="choose another port"
            ) from None

        # a sample never waits for a command
        receiver.setblocking(False)
        yield receiver


class _Listener:
    """What is commanded, and when a datagram last came."""

    def __init__(
        self,
        receiver: socket.socket,
        log: Callable[[str], None],
        now_ns: Callable[[], int],
    ) -> None:
        self._receiver = receiver
        self._log = log
        self._now_ns = now_ns
        self._opening = False
        self._last_ns: int | None = None
        self._link: CommandLink = "none"

    def ask(self) -> Command:
        """The command at this sample."""
        # an override among many datagrams of one sample must not be lost
        override = False
        for datagram in waiting(self._receiver):
            override |= self._take(datagram)
        if self._last_ns is not None and self._now_ns() - self._last_ns > EXPIRES_NS:
            self._expire()
        return Command(self._opening, override, self._link)

    def _take(self, datagram: bytes) -> bool:
        """Take one datagram; whether it overrides."""
        command = _read(datagram)
        if command is None:
            self._log(f"command: {printable(datagram)} (not understood)")
            return False

        self._last_ns = self._now_ns()
        self._link = "live"
        override = command.get("override", False)
        opening = command.get("opening", self._opening)
        if override or opening != self._opening:
            self._log(f"command: {printable(datagram)}")

        self._opening = opening
        return override

    def _expire(self) -> None:
        """Forget what was commanded: a silent sender may be gone."""
        self._log("command: the sender is silent; its last command has expired")
        self._opening = False
        self._last_ns = None
        self._link = "expired"


def waiting(receiver: socket.socket) -> Iterator[bytes]:
    """The datagrams that have come, at most MOST_A_SAMPLE."""
    for _ in range(MOST_A_SAMPLE):
        try:
            yield receiver.recv(LONGEST)
        except BlockingIOError:
            return


def printable(datagram: bytes) -> str:
    """As text without control characters."""
    text = datagram.decode(errors="replace")
    return "".join(letter if letter.isprintable() else "?" for letter in text)


def _read(datagram: bytes) -> dict[str, bool] | None:
    """The known keys with true or false; None where it is not understood."""
    try:
        keys = json_of(datagram)
    except ValueError:
        return None
    if not isinstance(keys, dict) or not set(keys) <= KEYS:
        return None
    if not all(isinstance(value, bool) for value in keys.values()):
        return None
    return keys
