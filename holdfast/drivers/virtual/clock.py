"""Time of the virtual hand: it passes when a bridge or a test spends it."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import AbstractContextManager, contextmanager, nullcontext
from typing import Any, Protocol


class Clock(Protocol):
    """The time by which a chip converts and that a bridge's transfers take."""

    def now_ns(self) -> int:
        """Monotonic, ns."""
        ...

    def spend(self, duration_ns: int) -> None:
        """Let time pass."""
        ...

    def at(self, t_ns: int) -> AbstractContextManager[None]:
        """Within the block: what a device did by itself at t_ns, while its host was away."""
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

    def at(self, t_ns: int) -> AbstractContextManager[None]:
        """It is t_ns within the block."""
        return self._moved(t_ns)

    @contextmanager
    def _moved(self, t_ns: int) -> Iterator[None]:
        now_ns, self._now_ns = self._now_ns, t_ns
        try:
            yield
        finally:
            self._now_ns = now_ns


class DeviceClock:
    """The time of a device that does something by itself while its host was away.

    clock: the host's, which stays where it is.
    """

    def __init__(self, clock: Any) -> None:
        self._clock = clock
        self._past_ns: int | None = None

    def now_ns(self) -> int:
        """ns."""
        now_ns: int = self._clock.now_ns() if self._past_ns is None else self._past_ns
        return now_ns

    def spend(self, duration_ns: int) -> None:
        """Let the host's time pass."""
        self._clock.spend(duration_ns)

    @contextmanager
    def at(self, t_ns: int) -> Iterator[None]:
        """It is t_ns within the block."""
        self._past_ns = t_ns
        try:
            yield
        finally:
            self._past_ns = None


class WallClock:
    """Real time: a bridge's transfers take as long as on real hardware."""

    def now_ns(self) -> int:
        """time.monotonic_ns."""
        return time.monotonic_ns()

    def spend(self, duration_ns: int) -> None:
        """Sleep."""
        if duration_ns > 0:
            time.sleep(1e-9 * duration_ns)

    def at(self, t_ns: int) -> AbstractContextManager[None]:
        """Real time cannot go back: the device is late."""
        return nullcontext()
