"""Real-time priority for the thread that reads a hand: woken when it is due, whatever else the
machine computes.

Linux gives it to root, to a process with CAP_SYS_NICE, and up to `ulimit -r` to everybody else;
where it does not, all works as before, only that a busy machine may wake the reader late.
"""

from __future__ import annotations

import os
from collections.abc import Iterator
from contextlib import contextmanager

PRIORITY = 10
"""Before every ordinary program, after the kernel's own threads that serve USB and the clock
(50)."""


@contextmanager
def real_time() -> Iterator[bool]:
    """Whether this thread has real-time priority (SCHED_FIFO) until the end; its threads and
    children never have."""
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
    """As it was, but that only the system may take the mark away that children do not inherit."""
    try:
        os.sched_setscheduler(0, policy, param)
    except PermissionError:
        os.sched_setscheduler(0, policy | os.SCHED_RESET_ON_FORK, param)
