"""Time of the virtual hand: it passes when a bridge or a test spends it."""

from __future__ import annotations

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
