"""Real-time priority for the thread that reads a hand, so it wakes on time on a busy machine.

Linux grants it to root, to a process with CAP_SYS_NICE, and to others up to `ulimit -r`. Without it
everything works as before, only a busy machine may wake the reader late.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

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
        os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(PRIORITY))
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
