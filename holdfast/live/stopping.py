"""When a live verb stops: after its time or on a signal; and how it treats lost terminals.

Tells systemd that the service has started and that it still answers samples (sd_notify(3)).

The protocol sends one datagram for each message to the socket in NOTIFY_SOCKET; without that
variable nothing is sent.

Messages of a verb to the person at the terminal, apart from its output.
"""

from __future__ import annotations

import os
import signal
import socket
import sys
import termios
import time
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import Any

from holdfast.core.errors import visible_lines


def until(
    stopped: Callable[[], bool], clock: Any, seconds: float | None
) -> Callable[[], bool]:
    """Stopped by a signal, or after a number of seconds."""
    end_ns = None if seconds is None else clock.now_ns() + round(1e9 * seconds)
    return lambda: stopped() or (end_ns is not None and clock.now_ns() >= end_ns)


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """SIGINT, SIGTERM and SIGHUP stop the verb after the current sample.

    A second SIGINT or SIGTERM has its usual effect. SIGHUP comes twice where an SSH connection
    drops, from the shell and from the system; under nohup it stays ignored. A terminal that is lost
    with it is replaced by /dev/null, because writing to it would be an error.
    """
    requested = False
    terminals = [handle for handle in (0, 1, 2) if os.isatty(handle)]

    def stop(number: int, frame: object) -> None:
        nonlocal requested
        requested = True
        if number == signal.SIGHUP:
            _let_go(terminals)
        else:
            signal.signal(number, before[number])

    under_nohup = signal.getsignal(signal.SIGHUP) == signal.SIG_IGN
    wanted = (
        (signal.SIGINT, signal.SIGTERM)
        if under_nohup
        else (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
    )
    before: dict[int, Any] = {number: signal.signal(number, stop) for number in wanted}
    try:
        yield lambda: requested
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def output_from_the_background() -> Iterator[None]:
    """Write to a terminal from the background too, where `stty tostop` would stop the program."""
    before = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGTTOU, before)


def _let_go(terminals: list[int]) -> None:
    """Redirect the descriptors of lost terminals to /dev/null; the others stay as they are."""
    for handle in terminals:
        try:
            termios.tcgetattr(handle)
        except termios.error:
            nothing = os.open(os.devnull, os.O_RDWR)
            os.dup2(nothing, handle)
            os.close(nothing)


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
    with socket.socket(
        socket.AF_UNIX, socket.SOCK_DGRAM | socket.SOCK_CLOEXEC
    ) as sender:
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


PROGRESS_EVERY_S = 2.0


def say(line: str) -> None:
    """Write a message to stderr."""
    sys.stderr.write(visible_lines(line) + "\n")


def progress_of(
    what: str, say: Callable[[str], None], now_s: Callable[[], float] = time.monotonic
) -> Callable[[float], None]:
    """A function that takes the share done and now and then says it, with the time left.

    >>> times = iter([0.0, 1.0, 3.0])
    >>> report = progress_of("simulating", print, lambda: next(times))
    >>> report(0.1)
    >>> report(0.25)
    simulating: 25 % done, about 9 s left
    """
    started_s = last_s = now_s()

    def report(share: float) -> None:
        nonlocal last_s
        at_s = now_s()
        if at_s - last_s < PROGRESS_EVERY_S or not 0.0 < share < 1.0:
            return
        last_s = at_s
        left_s = (at_s - started_s) * (1.0 - share) / share
        say(f"{what}: {100 * share:.0f} % done, about {left_s:.0f} s left")

    return report
