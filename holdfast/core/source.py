"""Sources of samples: what every driver, recording and scene gives to its reader."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.core.contract import SINCE_BOOT, BoolArray, FloatArray, Unit

# Real time: a monotonic clock that cannot be set and that also counts while the machine sleeps.


class MonotonicClock:
    """Time since the machine was started, and waiting until a time."""

    def now_ns(self) -> int:
        """ns since the machine was started."""
        return time.clock_gettime_ns(SINCE_BOOT)

    def wait_until(self, t_ns: int) -> None:
        """Sleep until t_ns; return at once where it has passed."""
        # A sleep runs on another clock, which may end it a little early: then the rest follows.
        while (remaining_ns := t_ns - self.now_ns()) > 0:
            time.sleep(1e-9 * remaining_ns)


@dataclass(frozen=True)
class SourceReading:
    """One reading of a source: values [C] in its unit, valid [S], why [S] not ("" where valid)."""

    t_ns: int
    values: FloatArray
    valid: BoolArray
    why: tuple[str, ...] = ()

    def without_values(self, why: str) -> SourceReading:
        """The same reading with no sensor valid, for a sample that did not come."""
        none: BoolArray = np.zeros(len(self.valid), dtype=np.bool_)
        return SourceReading(self.t_ns, self.values, none, (why,) * len(none))


class SourceUrl(NamedTuple):
    """A URL in parts: scheme, name or path, and options of the scheme's Struct."""

    url: str
    scheme: str
    name: str
    options: Any


class Source(Protocol):
    """A hand that can be read now: a driver, or a recording that is replayed in real time."""

    unit: Unit
    n_channels: int
    rate_hz: float | None
    """Of a recording; None where the reader decides the rate."""

    def read(self) -> SourceReading | None:
        """The newest reading; None where the source has ended."""
        ...

    def close(self) -> None:
        """Release the device or file."""
        ...


class SelfPacedSource:
    """Base of a source whose `read` waits for the next sample, so that it paces its reader.

    Where none comes in time, `read` returns an invalid reading about once a period.
    """


class Turns:
    """When a source is read: once a period from now on, and never late for a turn that has passed.

    A source that paces itself waits in its `read`: then nothing is waited for and nothing skipped.
    clock: has now_ns and wait_until. number: of this turn, from 0; gaps are turns that were
    skipped. start_ns: when turn 0 was due.
    """

    def __init__(self, source: Source, clock: Any, period_ns: float) -> None:
        # a schedule of this clock would drift from that of the source
        self._is_paced = isinstance(source, SelfPacedSource)
        self._clock = clock
        self._period_ns = period_ns
        self.start_ns: int = clock.now_ns()
        self.number = 0

    def wait(self) -> None:
        """Wait until this turn is due."""
        # from the start and not from the last turn: rounding and delays do not add up
        if not self._is_paced:
            due_ns = self.start_ns + round(self.number * self._period_ns)
            self._clock.wait_until(due_ns)

    def end(self) -> int:
        """Go on to the next turn that is not past; how many are skipped for that."""
        self.number += 1
        if self._is_paced:
            return 0
        # turns that are past are never made up for: late answers would act on old touch
        passed_ns = self._clock.now_ns() - self.start_ns
        skipped = max(0, int(passed_ns / self._period_ns) - self.number)
        self.number += skipped
        return skipped
