"""Counts of what may come too often to report each time.

A flood of lines that are skipped must not fill a log. The first ones within a second are reported
at once, with what they were; those that follow are counted, and reported together once a second.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

SECOND_NS = 1_000_000_000


class Tally:
    """Counts by kind. name: what the lines of the report begin with, such as "commands".

    most_a_second: how many are reported at once. total: all that was counted, by kind.
    """

    def __init__(
        self,
        name: str,
        report: Callable[[str], object],
        now_ns: Callable[[], int],
        most_a_second: int = 1,
    ) -> None:
        self._name = name
        self._report = report
        self._now_ns = now_ns
        self._most = most_a_second
        self._began_ns: int | None = None
        self._reported = 0
        self._waiting: Counter[str] = Counter()
        self.total: Counter[str] = Counter()

    def count(self, kind: str, shown: str, n: int = 1) -> None:
        """`n` more. kind: one of a few words, to count by; shown: these, for the report."""
        self.total[kind] += n
        self._begin_second()
        if self._reported < self._most and not self._waiting:
            self._reported += 1
            self._report(f"{self._name}: {shown}")
        else:
            self._waiting[kind] += n

    def look(self) -> None:
        """Report what was counted, where a second has passed. Call it once a sample."""
        if self._waiting:
            self._begin_second()

    def flush(self) -> None:
        """Report what was counted, if anything."""
        if self._waiting:
            kinds = sorted(self._waiting.items())
            more = ", ".join(f"{n:,} more {kind}" for kind, n in kinds)
            self._waiting.clear()
            self._report(f"{self._name}: {more}")

    def _begin_second(self) -> None:
        now_ns = self._now_ns()
        if self._began_ns is not None and now_ns - self._began_ns < SECOND_NS:
            return
        # what was counted is itself one report of the new second
        self._reported = 1 if self._waiting else 0
        self.flush()
        self._began_ns = now_ns
