"""Sources of samples: what every driver, recording and scene gives to its reader."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, NamedTuple, Protocol

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Unit


def block_means(
    values: FloatArray, valid: BoolArray, n: int
) -> tuple[FloatArray, BoolArray]:
    """values [T, C] and valid [T, S] of every n samples as one; what is left over is dropped.

    A mean of whole blocks, so that little folds back. A sensor is valid where more than half of its
    samples are, and its mean is of these.
    """
    blocks = len(values) // n
    by_sensor = values[: blocks * n].reshape(blocks, n, -1, 3)
    usable = np.isfinite(by_sensor).all(axis=3)
    usable &= valid[: blocks * n].reshape(blocks, n, -1)
    count = usable.sum(axis=1)
    total = np.where(usable[..., None], by_sensor, 0.0).sum(axis=1)
    means = total / np.maximum(count, 1)[..., None]
    return means.reshape(blocks, -1), 2 * count > n


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


class AveragedSource(SelfPaced):
    """Every n samples of a source that paces itself, as one at the time of the last."""

    def __init__(self, source: Source, n: int) -> None:
        self._source = source
        self._n = n
        self.unit = source.unit
        self.n_channels = source.n_channels
        rate_hz = source.rate_hz
        self.rate_hz: float | None = None if rate_hz is None else rate_hz / n

    def read(self) -> SourceReading | None:
        """The mean of the next samples; None where the source has ended."""
        readings = []
        for _ in range(self._n):
            reading = self._source.read()
            if reading is None:
                return None
            readings.append(reading)
        values = np.stack([one.values for one in readings])
        valid = np.stack([one.valid for one in readings])
        mean, usable = block_means(values, valid, self._n)
        why = next((one.why for one in readings if not one.valid.all()), ())
        return SourceReading(readings[-1].t_ns, mean[0], usable[0], why)

    def close(self) -> None:
        """Close the source."""
        self._source.close()
