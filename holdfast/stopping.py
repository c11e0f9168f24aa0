"""When a live verb stops: after its time, or on a signal; and what it then does with terminals that
are gone."""

from __future__ import annotations

import os
import signal
import termios
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from typing import Any


def until(stopped: Callable[[], bool], clock: Any, seconds: float | None) -> Callable[[], bool]:
    """Stopped by a signal, or after so many seconds."""
    end_ns = None if seconds is None else clock.now_ns() + round(1e9 * seconds)
    return lambda: stopped() or (end_ns is not None and clock.now_ns() >= end_ns)


@contextmanager
def stop_signals() -> Iterator[Callable[[], bool]]:
    """SIGINT, SIGTERM and SIGHUP ask to stop after the sample under way; a second one has its usual
    effect.

    Not so SIGHUP, which comes twice where an SSH connection drops, from the shell and from the
    system; under nohup it is left ignored. A terminal that is gone with it is replaced by nothing:
    a word to it would be an error.
    """
    asked = False
    terminals = [handle for handle in (0, 1, 2) if os.isatty(handle)]

    def ask(number: int, frame: object) -> None:
        nonlocal asked
        asked = True
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
    before: dict[int, Any] = {number: signal.signal(number, ask) for number in wanted}
    try:
        yield lambda: asked
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


@contextmanager
def output_from_the_background() -> Iterator[None]:
    """Write to a terminal also where it stops programs in its background that do (`stty tostop`),
    whole programs."""
    before = signal.signal(signal.SIGTTOU, signal.SIG_IGN)
    try:
        yield
    finally:
        signal.signal(signal.SIGTTOU, before)


def _let_go(terminals: list[int]) -> None:
    """Lead the descriptors of terminals that are gone to /dev/null; those still there stay as they
    are."""
    for handle in terminals:
        try:
            termios.tcgetattr(handle)
        except termios.error:
            nothing = os.open(os.devnull, os.O_RDWR)
            os.dup2(nothing, handle)
            os.close(nothing)
