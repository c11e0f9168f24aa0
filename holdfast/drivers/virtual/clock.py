"""Time of the virtual hand: it passes when a bridge or a test spends it."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """The time by which a chip converts and that a bridge's transfers take."""

    def now_ns(self) -> int:
        """Monotonic, ns."""
        ...

    def spend(self, duration_ns: int) -> None:
        """Let time pass."""
        ...


class VirtualClock:
    """Stands still until time is spent, so a minute passes as fast as it is computed."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        """Virtual time, ns."""
        return self._now_ns

    def spend(self, duration_ns: int) -> None:
        """Let time pass at once."""
        self._now_ns += max(0, duration_ns)

    def wait_until(self, t_ns: int) -> None:
        """Let time pass until t_ns."""
        self._now_ns = max(self._now_ns, t_ns)


class WallClock:
    """Real time: a bridge's transfers take as long as on real hardware."""

    def now_ns(self) -> int:
        """time.monotonic_ns."""
        return time.monotonic_ns()

    def spend(self, duration_ns: int) -> None:
        """Sleep."""
        if duration_ns > 0:
            time.sleep(1e-9 * duration_ns)
