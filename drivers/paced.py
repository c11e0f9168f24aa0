"""A recording replayed in real time: each row comes at the time at which it was recorded."""

from __future__ import annotations

from collections.abc import Callable

from holdfast.drivers.replay import Replay
from holdfast.edge_runtime.contract import Unit
from holdfast.edge_runtime.live import SourceReading


class PacedReplay:
    """A stream [T] as a live source. A late reader gets the newest row, as it would on a hand."""

    def __init__(self, replay: Replay, now_ns: Callable[[], int]) -> None:
        self._replay, self._now_ns = replay, now_ns
        self._start_ns: int | None = None
        self.unit: Unit = replay.unit
        self.n_channels = replay.values.shape[1]
        self.rate_hz: float | None = replay.rate_hz

    def read(self) -> SourceReading | None:
        """The row whose time has come; None after the last."""
        now_ns = self._now_ns()
        if self._start_ns is None:
            self._start_ns = now_ns
        row = round((now_ns - self._start_ns) * 1e-9 * self._replay.rate_hz)
        if row >= len(self._replay.values):
            return None
        return SourceReading(now_ns, self._replay.values[row], self._replay.valid[row])

    def begin_anew(self) -> None:
        """The next reading is the first row again."""
        self._start_ns = None

    def close(self) -> None:
        """Nothing is open."""
