"""Time of the virtual hand: it passes when somebody spends it."""

from __future__ import annotations

import time
from typing import Protocol


class Clock(Protocol):
    """What a chip converts by and a bridge spends its transfers on."""

    def now_ns(self) -> int:
        """Monotonic, ns."""
        ...

    def spend(self, duration_ns: int) -> None:
        """Let time pass."""
        ...


class VirtualClock:
    """Stands still until somebody spends time: a minute passes in as long as it takes to
    compute."""

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
    """Real time: a bridge's transfers really take as long as they would."""

    def now_ns(self) -> int:
        """time.monotonic_ns."""
        return time.monotonic_ns()

    def spend(self, duration_ns: int) -> None:
        """Sleep."""
        if duration_ns > 0:
            time.sleep(1e-9 * duration_ns)
