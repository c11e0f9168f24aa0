"""Sources of samples: what every driver, recording and scene gives to its reader."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Unit


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
