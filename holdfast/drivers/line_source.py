"""Lines of any program as a live source: silence, and what comes too fast.

The time of a sample is that of its arrival: a sender's clock is another one.

The source waits for the next sample, so the sender paces the loop. While none comes, the last
reading is given again, invalid, and the state is unknown. Of more than MOST_WAITING samples all but
the newest are dropped, and one invalid reading stands for them. What waited while nothing was read,
as between two trials, has no known time of arrival, and is dropped. Dropped samples are counted.

A recording that is read as lines (paced) is another matter: each row waits for its time.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray, Unit
from holdfast.core.errors import DeviceNotFound, RateError
from holdfast.core.hand_lines import LineRefused, Skipped, printable
from holdfast.core.source import SelfPaced, SourceReading
from holdfast.drivers.line_feeds import Feed
from holdfast.drivers.sample_lines import NAME_A_MAP, SampleLine, SampleReader

FIRST_S = 10.0
"""An opened source must send within this time."""
LOOK_S = 0.05
SETTLE_S, MEASURE_S = 0.2, 0.5
MEASURE_LINES = 20
"""The rate is measured over so many samples, and for so long; not over the first ones, because a
sender that was held up sends all that it has at once."""
WAIT_PERIODS = 2.0
"""A sample that comes later than this after the last one is missing: it would be late."""
MOST_WAITING = 2
PAUSE_PERIODS = 3.0
"""Where nothing was read for longer, what waits has no known time of arrival."""
SLOWER_RATES = 1.5
MOST_DROPPED = 4096
"""Pulls after which a sender that never pauses is not waited for."""
LOST, SKIPPED = "no sample came", "samples were dropped"
NOT_VALID = "not valid"
ToForce = Callable[[FloatArray], FloatArray]


@dataclass(frozen=True)
class LineOptions:
    """How lines are read. rate_hz: None where it is measured. paced: a recording."""

    rate_hz: float | None = None
    paced: bool = False


class LineSource(SelfPaced):
    """The lines of a feed as a source. clock: has now_ns and wait_until.

    report: receives what a person should know. to_force: a calibration, for lines in uT. Raises
    DeviceNotFound where no sample comes, RateError where a rate is not to be had, DeviceLost.
    """

    def __init__(
        self,
        feed: Feed,
        reader: SampleReader,
        clock: Any,
        report: Callable[[str], object],
        options: LineOptions,
        to_force: ToForce | None = None,
    ) -> None:
        self._feed = feed
        self._reader = reader
        self._clock = clock
        self._report = report
        self._options = options
        self._to_force = to_force
        self._skipped = Skipped(feed.name, report, clock.now_ns)
        self._waiting: deque[tuple[SampleLine, int]] = deque()
        self._is_silent = False
        self._given = 0
        self._offset_ns: int | None = None
        # what waited before this program began has no known time
        dropped = 0 if options.paced else self._drop_waiting()
        first = self._first_samples()
        self.rate_hz: float | None = options.rate_hz or self._measured_hz(first)
        self._period_ns = 1e9 / self.rate_hz
        if not options.paced:
            dropped += len(self._waiting) - 1
            self._waiting = deque(first[-1:])
        assert reader.map is not None
        self.unit: Unit = reader.map.unit_of_values if to_force is None else "N"
        self.n_channels = len(reader.map.channels)
        self.zero = reader.zero
        self._last = self._valued(*first[-1])
        self._looked_ns = clock.now_ns()
        stamps = "the recording" if options.paced else "arrival"
        report(
            f"{feed.name}: {self.n_channels // 3} sensors in {self.unit} at "
            f"{self.rate_hz:.4g} Hz, stamps of {stamps}"
            + (f"; {dropped:,} samples before that are dropped" if dropped else "")
        )

    # -- the first samples

    def _first_samples(self) -> list[tuple[SampleLine, int]]:
        """Enough of them to measure the rate; one where it is known."""
        waiting = self._waiting
        is_measured = not self._options.rate_hz and not self._options.paced
        enough = 1 if self._options.rate_hz else MEASURE_LINES
        least_ns = 1e9 * (SETTLE_S + MEASURE_S) if is_measured else 0.0
        until_ns = self._clock.now_ns() + round(1e9 * FIRST_S)
        while not self._feed.ended and self._clock.now_ns() < until_ns:
            self._collect(LOOK_S)
            lasted_ns = waiting[-1][1] - waiting[0][1] if waiting else 0
            if len(waiting) >= enough and lasted_ns >= least_ns:
                break

        if not waiting:
            raise self._no_sample()
        settled_ns = waiting[0][1] + round(1e9 * SETTLE_S)
        steady = [one for one in waiting if one[1] >= settled_ns]
        use_steady = is_measured and len(steady) >= MEASURE_LINES
        return steady if use_steady else list(waiting)

    def _no_sample(self) -> DeviceNotFound:
        cause = "its sender does not run, or its lines had come before this program ran"
        next_step = "start the sender; docs/on-a-hand.md shows the lines"
        if refused := self._skipped.total.most_common(1):
            kind, count = refused[0]
            cause = f"{count:,} lines were {kind}, as the message above shows"
            next_step = f"correct the lines, or {NAME_A_MAP}"
        return DeviceNotFound(
            f"no sample came in {FIRST_S:g} s",
            where=self._feed.name,
            cause=cause,
            next_step=next_step,
        )

    def _measured_hz(self, first: list[tuple[SampleLine, int]]) -> float:
        """Of the stamps if all have one, else of the arrivals. Raises RateError."""
        stamps = [line.stamp_ns for line, _ in first if line.stamp_ns is not None]
        if not self._options.paced and len(stamps) < len(first):
            stamps = [arrived_ns for _, arrived_ns in first]
        steps = np.diff(np.array(stamps, dtype=np.float64))
        # a gap of a recording says nothing about its rate; what comes live may come in bursts
        if self._options.paced and len(steps):
            steps = steps[steps < SLOWER_RATES * np.median(steps)]
        if not len(steps) or not steps.mean() > 0.0:
            raise RateError(
                "its rate cannot be measured",
                where=self._feed.name,
                cause="too few samples, or no column of time",
                next_step="add rate_hz=150 to the URL",
            )
        return float(1e9 / steps.mean())

    # -- one sample after another

    def read(self) -> SourceReading | None:
        """The next sample, or the last reading again with no sensor valid; None at the end.

        Raises DeviceLost.
        """
        reading = self._next_row() if self._options.paced else self._next_sample()
        if reading is not None:
            self._last = reading
        elif not self._feed.ended:
            return self._last.without_values(LOST)
        return reading

    def close(self) -> None:
        """Stop reading."""
        if self._feed.ended:
            ended = f"its lines ended after {self._given} samples"
            self._report(f"{self._feed.name}: {ended}")
        self._skipped.close()
        self._feed.close()

    def _next_sample(self) -> SourceReading | None:
        now_ns = self._clock.now_ns()
        if now_ns - self._looked_ns > PAUSE_PERIODS * self._period_ns:
            self._count_dropped(self._drop_waiting(), "nothing was read")
        # a missing sample is noticed late, and the ones after it one period later each
        periods = 1.0 if self._is_silent else WAIT_PERIODS
        until_ns = now_ns + round(periods * self._period_ns)
        self._collect(0.0)
        while not self._waiting and not self._feed.ended:
            left_s = 1e-9 * (until_ns - self._clock.now_ns())
            if left_s <= 0.0:
                break
            self._collect(left_s)
        self._looked_ns = self._clock.now_ns()
        self._is_silent = not self._waiting
        if not self._waiting:
            return None
        if len(self._waiting) > MOST_WAITING:
            # the newest is kept: an old sample would delay every later one
            newest = self._waiting.pop()
            self._last = self._valued(*self._waiting[-1])
            self._count_dropped(len(self._waiting), "more came than are read")
            self._waiting = deque([newest])
            return self._last.without_values(SKIPPED)
        self._given += 1
        return self._valued(*self._waiting.popleft())

    def _next_row(self) -> SourceReading | None:
        """The next row of a recording at its time; None while that is not near."""
        while not self._waiting and not self._feed.ended:
            self._collect(0.0)
        if not self._waiting:
            return None
        line, _ = self._waiting[0]
        stamp_ns = line.stamp_ns
        if stamp_ns is None:
            stamp_ns = round(self._given * self._period_ns)
        now_ns = self._clock.now_ns()
        if self._offset_ns is None:
            self._offset_ns = now_ns - stamp_ns
        due_ns = stamp_ns + self._offset_ns
        # a gap of the recording: the loop must not sleep through it
        if due_ns - now_ns > WAIT_PERIODS * self._period_ns:
            self._clock.wait_until(now_ns + round(self._period_ns))
            return self._last.without_values(LOST)
        self._clock.wait_until(due_ns)
        self._waiting.popleft()
        self._given += 1
        return self._valued(line, due_ns)

    def _drop_waiting(self) -> int:
        """Drop what came while nothing was read; headers count. Returns how many samples."""
        dropped = 0
        for _ in range(MOST_DROPPED):
            pulled = self._collect(0.0)
            dropped += len(self._waiting)
            self._waiting.clear()
            if not pulled:
                break
        return dropped

    def _count_dropped(self, n: int, why: str) -> None:
        if n:
            self._skipped.count("samples dropped", f"{n:,} samples dropped: {why}", n)

    def _collect(self, timeout_s: float) -> bool:
        """Take what comes; waits at most so long for the first bytes. Whether a line came."""
        lines = self._feed.pull(timeout_s)
        arrived_ns = self._clock.now_ns()
        for text in lines:
            try:
                line = self._reader.take(text, arrived_ns)
            except LineRefused as error:
                shown = f"{printable(text)} is skipped: {error}"
                self._skipped.count(error.kind, shown)
                continue
            if line is not None:
                self._waiting.append((line, arrived_ns))
        return bool(lines)

    def _valued(self, line: SampleLine, t_ns: int) -> SourceReading:
        values = line.values
        if self._to_force is not None:
            values = self._to_force(values.reshape(-1, 3)).reshape(-1)
        why = tuple("" if valid else NOT_VALID for valid in line.valid)
        return SourceReading(t_ns, values, line.valid, why)
