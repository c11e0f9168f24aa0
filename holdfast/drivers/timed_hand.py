"""EXPERIMENT: a hand whose scans an FT232H times itself (drivers/ft232h_timed.py), with recovery.

A scan is queued again and again as long as nothing else has to be done on the bus. A repair, or
another list of transfers, waits until the queue is empty; then the hand reads as without a queue,
which repairs what fails (drivers/hand.py), and queues again. A queue that fails is thrown away, and
its samples are lost. So a repair begins up to a queue's length later than without the experiment.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import replace
from typing import Any

from holdfast.core.errors import DeviceError, UsageError
from holdfast.drivers.bus import Bus
from holdfast.drivers.fingers import Reading
from holdfast.drivers.ft232h_timed import BLOCKS, TimedFt232h, most_block
from holdfast.drivers.hand import Hand, LiveHand
from holdfast.drivers.layout import LAYOUTS, Finger
from holdfast.drivers.scan_plan import ScanPlan

MOST_AHEAD = 16


class TimedHand(Hand):
    """A hand that numbers its readings by their period, once keep_time was called.

    open_bus: opens a TimedFt232h; ahead: scans queued at most. The rest is as for Hand.
    """

    def __init__(
        self,
        open_bus: Callable[[], Bus],
        fingers: Sequence[Finger] = LAYOUTS["mux"],
        *,
        ahead: int = MOST_AHEAD,
        pause: Callable[[float], None],
        **more: Any,
    ) -> None:
        super().__init__(open_bus, fingers, pause=pause, **more)
        self._block, self._pause = ahead // BLOCKS, pause
        self._period_ns: float | None = None
        self._start_ns, self._number, self._ran = 0, 0, False
        self._queued: tuple[TimedFt232h, ScanPlan] | None = None
        self._ns_per_byte: float | None = None
        """As measured; a bridge that comes back is not measured again."""

    def keep_time(self, period_ns: float) -> None:
        """From now on, reading n is due n periods from now, and `read` waits for it."""
        if isinstance(self._bus, TimedFt232h):
            with suppress(
                DeviceError
            ):  # the first scan meets the same failure and handles it
                self._bus.learn(self._driven.repeatable_plan().transfers)
        self._period_ns, self._start_ns, self._number = period_ns, self._now_ns(), 0

    def read(self) -> Reading:
        """The next scan, with its number where keep_time was called. Gaps in the numbers are lost.

        Raises UsageError where the first scans cannot be queued at this rate.
        """
        if self._period_ns is None:
            return super().read()
        queued = None if self._queued is None else self._next(*self._queued)
        return self._read_now(self._period_ns) if queued is None else queued

    def close(self) -> None:
        """Let the queued scans end, and give the bridge back."""
        self._end()
        super().close()

    def _next(self, bus: TimedFt232h, plan: ScanPlan) -> Reading | None:
        """The next queued scan; None where the queue failed."""
        try:
            one = bus.next()
        except (
            DeviceError
        ) as error:  # where it lasts, the next scan meets and handles it
            self._complain(error)
            self._end()
            return None
        self._number = one.number + 1
        scanned = self._driven.sort(plan, one.replies)
        reading = self._driven.judge(one.t_ns, scanned, came_ns=one.t_ns)
        if self._driven.repair_due(reading) or not self._driven.would_repeat(plan):
            bus.finish()
        if not bus.queued:
            self._queued = None
        self._report_changes(reading.why)
        return replace(reading, number=one.number)

    def _read_now(self, period_ns: float) -> Reading:
        """A scan without a queue, in the first period that has none; then the queue begins."""
        passed = (self._now_ns() - self._start_ns) / period_ns
        number = max(self._number, math.floor(passed))
        wait_ns = self._start_ns + number * period_ns - self._now_ns()
        self._pause(1e-9 * max(wait_ns, 0.0))
        reading = super().read()
        self._number = number + 1
        if isinstance(self._bus, TimedFt232h) and reading.valid.any():
            self._begin(self._bus, period_ns)
        return replace(reading, number=number)

    def _begin(self, bus: TimedFt232h, period_ns: float) -> None:
        """Queue scans. Raises UsageError where they never fitted."""
        plan = self._driven.repeatable_plan()
        block = min(self._block, most_block(plan.transfers))
        bus.ns_per_byte = bus.ns_per_byte or self._ns_per_byte
        grid = {"start_ns": self._start_ns, "number": self._number}
        try:
            bus.begin(plan.transfers, period_ns, block, **grid)
        except UsageError:
            if not self._ran:
                raise
        except DeviceError:  # the next scan meets the same failure and handles it
            self._driven.forget_masks()
        else:
            self._ran, self._queued = True, (bus, plan)
            self._ns_per_byte = bus.ns_per_byte

    def _end(self) -> None:
        """Throw away what is queued."""
        if self._queued is not None:
            with suppress(DeviceError):
                self._queued[0].end()
        self._queued = None


class TimedLiveHand(LiveHand):
    """A timed hand as a live source; holdfast/live/loop.py calls keep_time."""

    _hand: TimedHand

    def keep_time(self, period_ns: float) -> None:
        """From now on, `read` waits for reading n, which is due n periods from now."""
        self._hand.keep_time(period_ns)
