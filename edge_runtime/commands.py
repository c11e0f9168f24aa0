"""What the user's own control commands, as datagrams: {"opening": true}, {"override": true}. A log
of its own.

opening lasts until it is taken back, or until no datagram has come for EXPIRES_NS: a sender repeats
what it means, or sends {} to say that it is still there. override counts for the sample at which it
came; how long it then lasts is the decision's (edge_runtime/decision.py). At most MOST_A_SAMPLE
datagrams are read at one sample: a flooded port delays commands, and no sample.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from edge_runtime.contract import CommandLink
from edge_runtime.errors import UsageError
from edge_runtime.live import Command
from edge_runtime.reading import json_of

LONGEST = 1024
MOST_A_SAMPLE = 32
KEYS = {"opening", "override"}
EXPIRES_NS = 300_000_000
"""A sender that has been silent for longer commands nothing any more."""


@contextmanager
def command_port(
    address: str, log: Callable[[str], None], now_ns: Callable[[], int]
) -> Iterator[Callable[[], Command]]:
    """Listen on HOST:PORT; what it yields is asked once a sample and never waits.

    log: every datagram that changes something or is not understood, and a sender that goes silent,
    one line each. now_ns: monotonic. Raises UsageError where the port cannot be listened on.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise UsageError(
            f"{address!r} is no address", next_step="HOST:PORT, such as 127.0.0.1:9001"
        )
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind((host, int(port)))
        except (OSError, OverflowError, ValueError) as error:
            raise UsageError(f"{address!r}: {error}", next_step="another port") from None
        receiver.setblocking(False)
        yield _Listener(receiver, log, now_ns).ask


class _Listener:
    """What has been commanded so far, and when a datagram last came."""

    def __init__(
        self, receiver: socket.socket, log: Callable[[str], None], now_ns: Callable[[], int]
    ) -> None:
        self._receiver, self._log, self._now_ns = receiver, log, now_ns
        self._opening = False
        self._heard_ns: int | None = None
        self._link: CommandLink = "none"

    def ask(self) -> Command:
        """What is commanded at this sample."""
        override = any([self._take(datagram) for datagram in _waiting(self._receiver)])
        if self._heard_ns is not None and self._now_ns() - self._heard_ns > EXPIRES_NS:
            self._expire()
        return Command(self._opening, override, self._link)

    def _take(self, datagram: bytes) -> bool:
        """One datagram; whether it overrides."""
        command = _read(datagram)
        if command is None:
            self._log(f"command: {_printable(datagram)} (not understood)")
            return False
        self._heard_ns, self._link = self._now_ns(), "live"
        override, opening = command.get("override", False), command.get("opening", self._opening)
        if override or opening != self._opening:
            self._log(f"command: {_printable(datagram)}")
        self._opening = opening
        return override

    def _expire(self) -> None:
        self._log("command: the sender is silent; its last command has expired")
        self._opening, self._heard_ns, self._link = False, None, "expired"


def _waiting(receiver: socket.socket) -> Iterator[bytes]:
    for _ in range(MOST_A_SAMPLE):
        try:
            yield receiver.recv(LONGEST)
        except BlockingIOError:
            return


def _printable(told: bytes) -> str:
    """As text that leaves a terminal as it is."""
    return "".join(c if c.isprintable() else "?" for c in told.decode(errors="replace"))


def _read(datagram: bytes) -> dict[str, bool] | None:
    """The known keys with true or false; None where it is not understood."""
    try:
        found = json_of(datagram)
    except ValueError:
        return None
    if (
        not isinstance(found, dict)
        or not set(found) <= KEYS
        or not all(isinstance(v, bool) for v in found.values())
    ):
        return None
    return found
