"""Real time: the machine's monotonic clock, which nobody sets."""

from __future__ import annotations

import time


class MonotonicClock:
    """time.monotonic_ns, and waiting for it."""

    def now_ns(self) -> int:
        """ns since some moment of the machine's own."""
        return time.monotonic_ns()

    def wait_until(self, t_ns: int) -> None:
        """Sleep until t_ns; at once where it is past."""
        remaining_ns = t_ns - time.monotonic_ns()
        if remaining_ns > 0:
            time.sleep(1e-9 * remaining_ns)
