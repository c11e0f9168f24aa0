"""Tells systemd that the service has started and that it still answers samples (sd_notify(3)).

The protocol sends one datagram for each message to the socket in NOTIFY_SOCKET; without that
variable nothing is sent.
"""

from __future__ import annotations

import os
import socket
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress

EVERY_NS = 100_000_000
"""Between two signs of life; WatchdogSec in holdfast.service is ten times as long."""


@contextmanager
def service_watchdog(
    environment: Mapping[str, str] = os.environ,
) -> Iterator[Callable[[int], None]]:
    """A function to call with the time (ns) after every answer.

    It sends READY at the first call, then WATCHDOG=1; STOPPING is sent at the end. It never waits
    and never raises: a service manager that does not listen delays no sample.
    """
    path = environment.get("NOTIFY_SOCKET", "")
    if not path:
        yield lambda now_ns: None
        return
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC) as sender:
        sender.setblocking(False)
        life = _Life(sender, "\0" + path[1:] if path.startswith("@") else path)
        yield life.sign
        life.send("STOPPING=1")


class _Life:
    """The signs of life of one service."""

    def __init__(self, sender: socket.socket, address: str) -> None:
        self._sender, self._address = sender, address
        self._last_ns: int | None = None

    def sign(self, now_ns: int) -> None:
        """An answer was given at now_ns."""
        if self._last_ns is None:
            self.send("READY=1")
        if self._last_ns is None or now_ns - self._last_ns >= EVERY_NS:
            self.send("WATCHDOG=1")
            self._last_ns = now_ns

    def send(self, message: str) -> None:
        """Send one datagram; it is lost where it cannot be sent at once."""
        with suppress(OSError):
            self._sender.sendto(message.encode(), self._address)
