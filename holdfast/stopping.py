"""When a live verb stops: after its time or on a signal; and how it treats lost terminals."""

from __future__ import annotations

import os
import signal
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


def until(stopped: Callable[[], bool], clock: Any, seconds: float | None) -> Callable[[], bool]:
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
