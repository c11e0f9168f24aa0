"""How a live program runs: its clock, priority and end, the lost terminal, and the service manager.

Linux grants real-time priority to root, to a process with CAP_SYS_NICE, and to others up to
`ulimit -r`. Without it everything works as before, only a busy machine may wake the reader late.

systemd is told that the service has started and that it still answers samples (sd_notify(3)): one
datagram for each message to the socket in NOTIFY_SOCKET; without that variable nothing is sent.
"""

from __future__ import annotations

import math
import os
import signal
import socket
import sys
import termios
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from typing import TYPE_CHECKING, Any

from holdfast.core.errors import visible_lines
from holdfast.core.source import MonotonicClock

if TYPE_CHECKING:
    from holdfast.core.contract import Prediction

PRIORITY = 10
"""Above every ordinary program, below the kernel's threads that serve USB and the clock (50)."""
NO_PRIORITY = (
    "no real-time priority: other programs can delay a sample; "
    "holdfast doctor says how to allow it"
)
SIGN_OF_LIFE_NS = 100_000_000
"""Between two signs of life; WatchdogSec in holdfast.service is ten times as long."""


class RunClock(MonotonicClock):
    """Real time; a virtual hand's transfers wait on it."""

    def spend(self, duration_ns: int) -> None:
        self.wait_until(self.now_ns() + duration_ns)


def until(
    stopped: Callable[[], bool], clock: Any, seconds: float | None, scene: Any = None
) -> Callable[[], bool]:
    """Stopped by a signal, after a number of seconds, or at the end of a scene with `ended`."""
    # on the run's clock, which stands still while a scene is computed
    end_ns = math.inf if seconds is None else clock.now_ns() + round(1e9 * seconds)

    def over() -> bool:
        at_end = scene is not None and scene.ended
        return stopped() or at_end or clock.now_ns() >= end_ns

    return over


@contextmanager
def real_time() -> Iterator[bool]:
    """Give this thread real-time priority (SCHED_FIFO) within the block; yields whether it has it.

    Its threads and children never have it.
    """
    before = os.sched_getscheduler(0)
    param = os.sched_getparam(0)
    # reset on fork: a thread or child with this priority could starve the reader
    first = os.SCHED_FIFO | os.SCHED_RESET_ON_FORK
    try:
        os.sched_setscheduler(0, first, os.sched_param(PRIORITY))
    except PermissionError:
        yield False
        return

    try:
        yield True
    finally:
        try:
            os.sched_setscheduler(0, before, param)
        except PermissionError:
            # only the system may remove the reset-on-fork mark
            os.sched_setscheduler(0, before | os.SCHED_RESET_ON_FORK, param)


@contextmanager
def real_time_priority(report: Callable[[str], None]) -> Iterator[bool]:
    """Real-time priority, or one message that there is none."""
    with real_time() as allowed:
        if not allowed:
            report(NO_PRIORITY)
        yield allowed


class StopRequest:
    """Called: whether a signal has asked the verb to stop. number: the signal, None before it."""

    number: int | None = None

    def __call__(self) -> bool:
        return self.number is not None

    @property
    def exit_code(self) -> int:
        """130 after Ctrl-C, as shells report it; 0 otherwise."""
        return 128 + signal.SIGINT if self.number == signal.SIGINT else 0


@contextmanager
def stop_signals() -> Iterator[StopRequest]:
    """SIGINT, SIGTERM and SIGHUP stop the verb after the current sample.

    A second SIGINT or SIGTERM has its usual effect. SIGHUP comes twice where an SSH connection
    drops, from the shell and from the system; under nohup it stays ignored. A terminal that is lost
    with it is replaced by /dev/null, because writing to it would be an error.
    """
    request = StopRequest()
    # only terminals: a file or a pipe is not lost with the connection
    terminals = list(filter(os.isatty, (0, 1, 2)))

    def stop(number: int, frame: object) -> None:
        # only a flag: the loop ends after the sample, so that outputs are closed in order
        request.number = number
        if number != signal.SIGHUP:
            signal.signal(number, before[number])
            return
        # lost terminals become /dev/null; the others stay as they are
        for handle in terminals:
            try:
                termios.tcgetattr(handle)
            except termios.error:
                nothing = os.open(os.devnull, os.O_RDWR)
                os.dup2(nothing, handle)
                os.close(nothing)

    wanted = [signal.SIGINT, signal.SIGTERM]
    # under nohup it is ignored, and stays so
    if signal.getsignal(signal.SIGHUP) != signal.SIG_IGN:
        wanted.append(signal.SIGHUP)

    before: dict[int, Any] = {number: signal.signal(number, stop) for number in wanted}
    try:
        yield request
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


class ServiceWatchdog:
    """An output that shows systemd each answer as a sign of life.

    It sends READY with the first answer, then WATCHDOG=1, and STOPPING at the end. It never waits
    and never raises: a service manager that does not listen delays no sample.
    """

    def __init__(self, environment: Mapping[str, str] = os.environ) -> None:
        path = environment.get("NOTIFY_SOCKET", "")
        # sd_notify(3): an @ stands for the zero byte of a socket without a file
        self._address = "\0" + path[1:] if path.startswith("@") else path
        self._sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        # a service manager that is busy must not hold up the loop
        self._sender.setblocking(False)
        self._last_ns = -SIGN_OF_LIFE_NS

    def write(
        self,
        prediction: Prediction,
        sample: object = None,
        reading: object = None,
        command: object = None,
    ) -> None:
        """Say that the first answer was given, and from then on that the run is alive."""
        now_ns = prediction.t_decided_ns
        if self._last_ns < 0:
            self._send("READY=1")
        if now_ns - self._last_ns >= SIGN_OF_LIFE_NS:
            self._send("WATCHDOG=1")
            self._last_ns = now_ns

    def close(self, reason: str = "") -> None:
        self._send("STOPPING=1")
        self._sender.close()

    def _send(self, message: str) -> None:
        """Send one datagram; it is lost where it cannot be sent at once."""
        if self._address:
            with suppress(OSError):
                self._sender.sendto(message.encode(), self._address)


def say(line: str) -> None:
    """Write a message to stderr."""
    sys.stderr.write(visible_lines(line) + "\n")
