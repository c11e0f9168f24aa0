"""Samples that come by themselves, as a source that paces its reader.

While none comes, the last reading is given again, invalid, and the state is unknown. Of more than
MOST_WAITING samples all but the newest are dropped, and one invalid reading stands for them.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from typing import Any

from holdfast.core.hand_lines import SkippedLines
from holdfast.core.source import SelfPacedSource, SourceReading

WAIT_PERIODS = 2.0
"""A sample that comes later than this after the last one is missing: it would be late."""
MOST_WAITING = 2
LOST, SKIPPED = "no sample came", "samples were dropped"


class Arrivals(SelfPacedSource):
    """Base of such a source; `collect` of a subclass appends what came to `waiting`.

    name: for messages. clock: has now_ns and wait_until. report: receives what a person should
    know. rate_hz and last, the newest reading, are known before the first `read`. ended: no sample
    will ever come again.
    """

    rate_hz: float | None
    last: SourceReading

    def __init__(self, name: str, clock: Any, report: Callable[[str], object]) -> None:
        self.clock = clock
        self.skipped = SkippedLines(name, report, clock.now_ns)
        self.waiting: deque[SourceReading] = deque()
        self.ended = False
        self._is_silent = False

    def collect(self, timeout_s: float) -> object:
        """Take what has come; wait at most so long for the first of it."""
        raise NotImplementedError

    def begin(self) -> int:
        """Keep the newest of the first samples; how many are dropped before it."""
        dropped = len(self.waiting) - 1
        self.last = self.waiting[-1]
        self.waiting = deque([self.last])
        return dropped

    def periods_ns(self, count: float) -> int:
        """The duration of so many samples."""
        assert self.rate_hz is not None
        return round(1e9 * count / self.rate_hz)

    def read(self) -> SourceReading | None:
        """The next sample, or the last reading again with no sensor valid; None at the end."""
        # a missing sample is noticed late, and the ones after it one period later each
        periods = 1.0 if self._is_silent else WAIT_PERIODS
        until_ns = self.clock.now_ns() + self.periods_ns(periods)
        self.collect(0.0)
        while not self.waiting and not self.ended:
            left_s = 1e-9 * (until_ns - self.clock.now_ns())
            if left_s <= 0.0:
                break
            self.collect(left_s)
        self._is_silent = not self.waiting
        if not self.waiting:
            return None if self.ended else self.last.without_values(LOST)
        if len(self.waiting) > MOST_WAITING:
            # the newest is kept: an old sample would delay every later one
            newest = self.waiting.pop()
            self.last = self.waiting[-1]
            self.count_dropped(len(self.waiting), "more came than are read")
            self.waiting = deque([newest])
            return self.last.without_values(SKIPPED)
        self.last = self.waiting.popleft()
        return self.last

    def count_dropped(self, n: int, why: str) -> None:
        """Count samples that are never read, and report them."""
        if n:
            self.skipped.count("samples dropped", f"{n:,} samples dropped: {why}", n)
