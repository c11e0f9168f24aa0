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


class SelfPaced:
    """Base of a source whose `read` waits for the next sample, so that it paces its reader.

    Where none comes in time, `read` returns an invalid reading about once a period.
    """
