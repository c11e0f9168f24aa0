"""Whether samples can be trusted, next to the guard in the graph: repeats, rate, a loaded start.

Each watch takes one sample at a time and answers yes or no. No watch knows a clock or a model.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from holdfast.core.contract import RATE_TOLERANCE, BoolArray, FloatArray

RING = 8
"""A hand repeats itself if it cycles through this many readings or fewer."""
ONE_NUMBER = np.sqrt(np.array([2.0, 3.0, 5.0]))
"""Combines a sensor's three numbers into one; two different readings hardly ever give the same."""
LEAST_SPAN = 10
"""The rate is not judged on fewer samples: jitter of 0.45 periods moves the mean of ten by 9 %."""
EMPTY_S = 0.2
"""A hand that reads its unloaded bias for this long is empty."""


class RepeatWatch:
    """Counts, for each sensor, readings in a row that equal an earlier one at the same distance.

    A live sensor has noise, so no distance of 1 to RING readings fits for long. Readings count only
    while the sensor is usable, so a lost sample in between does not hide that it is stuck.
    """

    def __init__(self, n_sensors: int, most: int) -> None:
        """most: repeats in a row from which on a sensor is stuck."""
        self._most = most
        # row k: the reading k + 1 samples ago, and for how long it has repeated
        self._past: FloatArray = np.full((RING, n_sensors), np.nan)
        self._runs: FloatArray = np.zeros((RING, n_sensors))

    def stuck(self, values: FloatArray, usable: BoolArray) -> bool:
        """Whether all usable sensors, at least one, are stuck after this sample.

        values: [C]. usable: [S].
        """
        whole = bool(usable.all())
        if not whole:
            values = np.where(np.repeat(usable, 3), values, 0.0)

        reading = values.reshape(-1, 3) @ ONE_NUMBER

        # -0.0 equals 0.0, and NaN equals nothing
        runs = (self._runs + 1.0) * (self._past == reading)
        if whole:
            self._runs = runs
            self._past[1:] = self._past[:-1]
            self._past[0] = reading
        else:
            self._runs[:, usable] = runs[:, usable]
            self._past[1:, usable] = self._past[:-1, usable]
            self._past[0, usable] = reading[usable]

        # nearly every sample ends here, and cheaply
        if runs.max() < self._most:
            return False

        longest = self._runs.max(axis=0)[usable]
        return bool(usable.any() and (longest >= self._most).all())


class RateWatch:
    """Compares the time of the last `span` samples with what they should have taken.

    The rate is wrong where both the mean and the median of the intervals are wrong: a gap changes
    the mean alone, and regular jitter the median alone. Losses that `sequence` counts change
    neither.
    """

    def __init__(self, rate_hz: float, span: int) -> None:
        self._period_ns = 1e9 / rate_hz
        # n intervals lie between n + 1 stamps
        stamps = max(span, LEAST_SPAN) + 1
        self._past: deque[tuple[int, int]] = deque(maxlen=stamps)

    def fits(self, t_ns: int, sequence: int) -> bool:
        """Take a sample's stamp; whether the rate is within tolerance, or cannot be judged yet."""
        past = self._past
        past.append((t_ns, sequence))
        if len(past) <= LEAST_SPAN:
            return True

        first_ns, first_sequence = past[0]
        # a source that counts nothing repeats its number: then the samples count
        steps = max(sequence - first_sequence, len(past) - 1)
        mean_periods = (t_ns - first_ns) / (steps * self._period_ns)
        if self._within(mean_periods):
            return True

        return self._within(self._median_ns() / self._period_ns)

    def forget(self) -> None:
        """Start again: the next stamp is not related to the last one."""
        self._past.clear()

    def _within(self, periods: float) -> bool:
        """Whether so many periods are one period, within the tolerance."""
        return abs(periods - 1.0) <= RATE_TOLERANCE

    def _median_ns(self) -> float:
        """The median interval, each divided by the steps between its sequence numbers."""
        stamps = np.array(self._past, dtype=np.int64)
        intervals_ns = np.diff(stamps[:, 0])
        steps = np.maximum(np.diff(stamps[:, 1]), 1)
        return float(np.median(intervals_ns / steps))


class LoadedStart:
    """Whether the hand has been empty since the start, judged by its stored unloaded bias.

    Until then the answer must not be "nothing". loaded: it was not empty when first judged, and has
    not been since.
    """

    def __init__(self, empty_below: float, rate_hz: float, least_sensors: int) -> None:
        """empty_below: a finger with a larger force or field, in the stream's unit, is loaded.

        least_sensors: samples with fewer usable sensors are not judged.
        """
        self._empty_below = empty_below
        self._samples = max(1, round(EMPTY_S * rate_hz))
        self._least_sensors = max(1, least_sensors)
        self._taken = self._empty_run = 0
        self.seen_empty = False

    @property
    def loaded(self) -> bool:
        """Whether the hand held something at the start, as far as has been seen."""
        return not self.seen_empty and self._taken >= self._samples

    def take(self, values: FloatArray, usable: BoolArray) -> None:
        """One sample, values [C] without bias and usable [S]."""
        if self.seen_empty or usable.sum() < self._least_sensors:
            return

        # squares, so that no root is taken at every sample
        vectors = values.reshape(-1, 3)[usable]
        squares = (vectors**2).sum(axis=1)
        empty = bool((squares <= self._empty_below**2).all())
        self._taken += 1
        # in a row: a hand that only passes through zero is not empty
        self._empty_run = self._empty_run + 1 if empty else 0
        self.seen_empty = self._empty_run >= self._samples
