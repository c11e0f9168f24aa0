"""Counts of what comes too often to report each time: at most one line a second.

A flood of lines that are skipped must not fill a log. The first of a kind is reported at once, with
what it was; those that follow within a second are counted, and reported together.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Callable

SECOND_NS = 1_000_000_000


class Tally:
    """Counts by kind. name: what the lines of the report begin with, such as "commands".

    total: all that was counted since the start, by kind.
    """

    def __init__(
        self, name: str, report: Callable[[str], object], now_ns: Callable[[], int]
    ) -> None:
        self._name = name
        self._report = report
        self._now_ns = now_ns
        self._reported_ns: int | None = None
        self._waiting: Counter[str] = Counter()
        self.total: Counter[str] = Counter()

    def count(self, kind: str, shown: str = "") -> None:
        """One more. shown: what it was, for the report where it is the first within a second."""
        self.total[kind] += 1
        now_ns = self._now_ns()
        if self._waiting or not self._is_quiet(now_ns):
            self._waiting[kind] += 1
            return
        self._reported_ns = now_ns
        self._report(f"{self._name}: {f'{shown} ' if shown else ''}({kind})")

    def look(self) -> None:
        """Report what was counted, where a second has passed. Call it once a sample."""
        if self._waiting and self._is_quiet(self._now_ns()):
            self.flush()

    def flush(self) -> None:
        """Report what was counted, if anything."""
        if not self._waiting:
            return
        self._reported_ns = self._now_ns()
        kinds = ", ".join(f"{n:,} {kind}" for kind, n in sorted(self._waiting.items()))
        self._waiting.clear()
        self._report(f"{self._name}: skipped since the last report: {kinds}")

    def _is_quiet(self, now_ns: int) -> bool:
        return self._reported_ns is None or now_ns - self._reported_ns >= SECOND_NS
