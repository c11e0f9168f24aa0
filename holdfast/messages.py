"""Messages of a verb to the person at the terminal, apart from its output."""

from __future__ import annotations

import sys
import time
from collections.abc import Callable

from holdfast.edge_runtime.visible import visible_lines

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
