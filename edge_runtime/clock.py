"""Real time: the machine's monotonic clock, which nobody sets, and which goes on while the machine
is suspended."""

from __future__ import annotations

import time

SINCE_BOOT = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
"""CLOCK_MONOTONIC stands still in a suspended machine: the samples before and after would seem to
be neighbours."""


class MonotonicClock:
    """Time since the machine was started, and waiting for it."""

    def now_ns(self) -> int:
        """ns since some moment of the machine's own."""
        return time.clock_gettime_ns(SINCE_BOOT)

    def wait_until(self, t_ns: int) -> None:
        """Sleep until t_ns; at once where it is past."""
        remaining_ns = t_ns - self.now_ns()
        if remaining_ns > 0:
            time.sleep(1e-9 * remaining_ns)
