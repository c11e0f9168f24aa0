"""The bias of a hand that touches nothing, measured now, and whether it is good enough to use."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.errors import DataError
from holdfast.core.source import SelfPaced, Source
from holdfast.drivers.calibration import Bias, bias_of

RATE_HZ = 100.0
"""Of a hand, which has no fixed rate."""


@dataclass(frozen=True)
class MeasuredBias:
    """A bias, what is wrong with it in words, and whether it is good.

    A reversed magnet is reported but good: the model's preparation inverts it.
    """

    bias: Bias
    warnings: tuple[str, ...]

    @property
    def good(self) -> bool:
        """Whether there is no warning but that of a reversed magnet."""
        return len(self.warnings) == int(self.bias.reversed.any())


def measure_bias(
    source: Source, clock: Any, report: Callable[[str], None], seconds: float
) -> MeasuredBias:
    """Read the hand for some seconds and judge what it reads; warnings go to `report`."""
    report(f"measuring the bias: leave the hand open, touch nothing for {seconds:g} s")
    bias, warnings = bias_of(read_rows(source, clock, seconds), source.unit)
    for warning in warnings:
        report(f"warning: {warning}")
    return MeasuredBias(bias, tuple(warnings))


def require_good(measured: MeasuredBias, consequence: str) -> None:
    """Raise DataError for a bias that is not good; consequence: what then is not done."""
    if not measured.good:
        raise DataError(
            f"the bias is not good, {consequence}",
            cause="; ".join(measured.warnings),
            next_step="correct that, or add --anyway",
        )


def read_rows(source: Source, clock: Any, seconds: float) -> FloatArray:
    """[T, C] of a source at its rate or at RATE_HZ, nan where a sensor is not valid."""
    # an absolute schedule, as in the live loop: one slow reading shifts no other
    start_ns = clock.now_ns()
    # a stream sends at its own rate, and a hand is read as asked
    rate_hz = source.rate_hz or RATE_HZ
    rows = []
    for k in range(round(seconds * rate_hz)):
        if not isinstance(source, SelfPaced):
            clock.wait_until(start_ns + round(k * 1e9 / rate_hz))
        measured = source.read()
        # a recording that is shorter than asked for is measured as far as it goes
        if measured is None:
            break
        # a finger is valid or not with all three of its axes
        valid = np.repeat(measured.valid, 3)
        rows.append(np.where(valid, measured.values, np.nan))

    return np.array(rows).reshape(-1, source.n_channels)
