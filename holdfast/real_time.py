"""Real time: the clock of a live verb, and the priority of the thread that reads a hand."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager

from edge_runtime.clock import MonotonicClock
from edge_runtime.priority import real_time


class RunClock(MonotonicClock):
    """Real time; a virtual hand's transfers wait on it."""

    def spend(self, duration_ns: int) -> None:
        """Let time pass."""
        self.wait_until(self.now_ns() + duration_ns)


@contextmanager
def first_in_line(say: Callable[[str], None]) -> Iterator[bool]:
    """Real-time priority, or one message that there is none."""
    with real_time() as allowed:
        if not allowed:
            say(
                "no real-time priority: other programs can delay a sample; "
                "holdfast doctor says how to allow it"
            )
        yield allowed
