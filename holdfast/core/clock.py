"""Real time: a monotonic clock that cannot be set and that also counts while the machine sleeps."""

from __future__ import annotations

import time

from holdfast.core.contract import SINCE_BOOT


class MonotonicClock:
    """Time since the machine was started, and waiting until a time."""

    def now_ns(self) -> int:
        """ns since the machine was started."""
        return time.clock_gettime_ns(SINCE_BOOT)

    def wait_until(self, t_ns: int) -> None:
        """Sleep until t_ns; return at once where it has passed."""
        # A sleep runs on another clock, which may end it a little early: then the rest follows.
        while (remaining_ns := t_ns - self.now_ns()) > 0:
            time.sleep(1e-9 * remaining_ns)
