"""Whether what comes in can be believed at all, beside the graph's own guard: repeats, the rate, a
loaded start.

Each watch takes one sample at a time and answers yes or no; none knows a clock or a model.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from edge_runtime.contract import RATE_TOLERANCE, BoolArray, FloatArray

RING = 8
"""A hand that is stuck in so many readings or fewer, over and over, repeats itself."""
ONE_NUMBER = np.sqrt(np.array([2.0, 3.0, 5.0]))
"""Makes one number of a sensor's three: two readings of different numbers hardly ever give the
same, and never for long."""
LEAST_SPAN = 8
"""Samples: a rate is not judged on fewer."""
EMPTY_S = 0.2
"""A hand that reads its unloaded bias for so long is empty."""


class RepeatWatch:
    """Counts, for each sensor, readings in a row that equal an earlier one of its own at the same
    distance.

    A live sensor has noise: no distance of 1 to RING readings fits for long. Readings are counted
    only where the sensor is usable, so a lost sample in between does not hide that it is stuck.
    """

    def __init__(self, n_sensors: int, most: int) -> None:
        """most: repeats in a row from which on a sensor is stuck."""
        self._most = most
        self._past: FloatArray = np.full((RING, n_sensors), np.nan)
        self._runs: FloatArray = np.zeros((RING, n_sensors))

    def stuck(self, values: FloatArray, usable: BoolArray) -> bool:
        """Take a sample, values [C] and usable [S]; whether every usable sensor, at least one, is
        stuck."""
        whole = bool(usable.all())
        reading = (values if whole else np.where(np.repeat(usable, 3), values, 0.0)).reshape(
            -1, 3
        ) @ ONE_NUMBER
        runs = (self._runs + 1.0) * (self._past == reading)  # -0.0 equals 0.0, and NaN nothing
        if whole:
            self._runs = runs
            self._past[1:] = self._past[:-1]
            self._past[0] = reading
        else:
            self._runs[:, usable] = runs[:, usable]
            self._past[1:, usable] = self._past[:-1, usable]
            self._past[0, usable] = reading[usable]
        if runs.max() < self._most:
            return False
        return bool(usable.any() and (self._runs.max(axis=0)[usable] >= self._most).all())


class RateWatch:
    """Compares the time that passed over the last `span` samples with what they should have taken.

    The rate is wrong where both the mean and the median of the intervals are: a gap spoils the mean
    alone, and regular jitter the median alone. Losses that `sequence` counts spoil neither.
    """

    def __init__(self, rate_hz: float, span: int) -> None:
        self._period_ns = 1e9 / rate_hz
        self._past: deque[tuple[int, int]] = deque(maxlen=max(span, LEAST_SPAN) + 1)

    def fits(self, t_ns: int, sequence: int) -> bool:
        """Take a sample's stamp; whether the rate is within tolerance, or cannot be judged yet."""
        past = self._past
        past.append((t_ns, sequence))
        if len(past) <= LEAST_SPAN:
            return True
        steps = max(sequence - past[0][1], len(past) - 1)
        return self._within(t_ns - past[0][0], steps) or self._within(*self._median())

    def forget(self) -> None:
        """Begin anew: the next stamp has nothing to do with the last."""
        self._past.clear()

    def _within(self, passed_ns: float, steps: int) -> bool:
        return abs(passed_ns / (steps * self._period_ns) - 1.0) <= RATE_TOLERANCE

    def _median(self) -> tuple[float, int]:
        """The middle one of the intervals, each over the steps that its sequence numbers are
        apart."""
        stamps = np.array(self._past, dtype=np.int64)
        steps = np.maximum(np.diff(stamps[:, 1]), 1)
        return float(np.median(np.diff(stamps[:, 0]) / steps)), 1


class LoadedStart:
    """Whether the hand has been seen empty since the start, as its stored unloaded bias says.

    Until then "nothing" must not be answered. loaded: it was not empty when first judged, and has
    not been since.
    """

    def __init__(self, empty_below: float, rate_hz: float, least_sensors: int) -> None:
        """empty_below: a finger whose force or field is larger, in the stream's unit, carries
        something.

        least_sensors: samples with fewer usable sensors are not judged.
        """
        self._empty_below, self._samples = empty_below, max(1, round(EMPTY_S * rate_hz))
        self._least_sensors = max(1, least_sensors)
        self._taken = self._empty = 0
        self.seen_empty = False

    @property
    def loaded(self) -> bool:
        """Whether the hand started while it held something, as far as has been seen."""
        return not self.seen_empty and self._taken >= self._samples

    def take(self, values: FloatArray, usable: BoolArray) -> None:
        """One sample, values [C] without bias and usable [S]."""
        if self.seen_empty or usable.sum() < self._least_sensors:
            return
        squares = (values.reshape(-1, 3)[usable] ** 2).sum(axis=1)
        self._taken += 1
        self._empty = self._empty + 1 if bool((squares <= self._empty_below**2).all()) else 0
        self.seen_empty = self._empty >= self._samples
