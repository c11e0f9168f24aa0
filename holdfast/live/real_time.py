"""Real time: the clock of a live verb, and the priority of the thread that reads a hand.

Real-time priority for the thread that reads a hand, so it wakes on time on a busy machine.

Linux grants it to root, to a process with CAP_SYS_NICE, and to others up to `ulimit -r`. Without it
everything works as before, only a busy machine may wake the reader late.
"""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from holdfast.core.clock import MonotonicClock

PRIORITY = 10
"""Above every ordinary program, below the kernel's threads that serve USB and the clock (50)."""


@contextmanager
def real_time() -> Iterator[bool]:
    """Give this thread real-time priority (SCHED_FIFO) within the block; yields whether it has it.

    Its threads and children never have it.
    """
    if not hasattr(os, "sched_setscheduler"):
        yield False
        return
    before, param = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(
            0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY)
        )
    except PermissionError:
        yield False
        return
    try:
        yield True
    finally:
        _give_back(before, param)


def _give_back(policy: int, param: os.sched_param) -> None:
    """Restore the old policy; only the system may remove the reset-on-fork mark."""
    try:
        os.sched_setscheduler(0, policy, param)
    except PermissionError:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, param)


NO_PRIORITY = (
    "no real-time priority: other programs can delay a sample; "
    "holdfast doctor says how to allow it"
)


class RunClock(MonotonicClock):
    """Real time; a virtual hand's transfers wait on it."""

    def spend(self, duration_ns: int) -> None:
        """Let time pass."""
        self.wait_until(self.now_ns() + duration_ns)


class SceneClock(RunClock):
    """Real time, but for a scene that is computed in the loop: the clock stands still meanwhile.

    No such time passes on a real hand. It is made up for where the loop would wait, so a machine
    with time to spare keeps to real time, and a slower one takes longer without being late.
    """

    def __init__(self) -> None:
        self._behind_ns = 0

    def now_ns(self) -> int:
        """ns; behind the machine's clock by what is not yet made up for."""
        return super().now_ns() - self._behind_ns

    def wait_until(self, t_ns: int) -> None:
        """Go on to t_ns: first by what the clock is behind, then by waiting."""
        remaining_ns = max(t_ns - self.now_ns(), 0)
        self._behind_ns -= min(remaining_ns, self._behind_ns)
        super().wait_until(t_ns)

    @contextmanager
    def still(self) -> Iterator[None]:
        """A block that takes no time."""
        began_ns = super().now_ns()
        try:
            yield
        finally:
            self._behind_ns += super().now_ns() - began_ns


@contextmanager
def first_in_line(say: Callable[[str], None]) -> Iterator[bool]:
    """Real-time priority, or one message that there is none."""
    with real_time() as allowed:
        if not allowed:
            say(NO_PRIORITY)
        yield allowed
