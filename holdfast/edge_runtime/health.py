"""Whether samples can be trusted, next to the guard in the graph.

Watched are repeats of the whole hand, single frozen sensors, the rate and a loaded start. Each
watch takes one sample at a time. No watch knows a clock or a model.
"""

from __future__ import annotations

from collections import deque

import numpy as np

from holdfast.core.contract import RATE_TOLERANCE, BoolArray, FloatArray

RING = 8
"""A hand repeats itself if it cycles through this many readings or fewer."""
NO_RUNS = [0] * RING
LEAST_SPAN = 10
"""The rate is not judged on fewer samples: jitter of 0.45 periods moves the mean of ten by 9 %."""
EMPTY_S = 0.2
"""A hand that reads its unloaded bias for this long is empty."""
FROZEN_S = 0.2
"""A noisy sensor that repeats its reading for so long is frozen."""
NOISY_S = 0.5
"""A sensor is noisy after so many turns of its reading, less two for each sample without one."""


class RepeatWatch:
    """Counts, for each sensor, readings in a row that equal an earlier one at the same distance.

    A live sensor has noise, so no distance of 1 to RING readings fits for long. Readings count only
    while the sensor is usable, so a lost sample in between does not hide that it is stuck.
    """

    def __init__(self, n_sensors: int, most: int) -> None:
        """most: repeats in a row from which on a sensor is stuck."""
        self._most = most
        self._sensors = [_Repeats() for _ in range(n_sensors)]

    def stuck(self, values: FloatArray, usable: BoolArray) -> bool:
        """Whether all usable sensors, at least one, are stuck after this sample.

        values: [C]. usable: [S].
        """
        # Python's own numbers: a dozen calls of numpy take longer, with cold caches
        readings = values.reshape(-1, 3).tolist()
        repeats = []
        for sensor, one, here in zip(
            self._sensors, readings, usable.tolist(), strict=True
        ):
            if here:
                repeats.append(sensor.longest(one))
        return min(repeats, default=-1) >= self._most


class _Repeats:
    """The last readings of one sensor, the newest first, and for how long each has repeated."""

    def __init__(self) -> None:
        self._past: deque[list[float]] = deque(maxlen=RING)
        self._runs = NO_RUNS

    def longest(self, reading: list[float]) -> int:
        """Take a reading; for how many readings in a row some distance fits."""
        runs = NO_RUNS
        # nearly every reading ends here, and cheaply; -0.0 equals 0.0, and NaN equals nothing
        if reading in self._past:
            runs = [0] * RING
            for distance, one in enumerate(self._past):
                if one == reading:
                    runs[distance] = self._runs[distance] + 1
        self._runs = runs
        self._past.appendleft(reading)
        return max(runs)


class FrozenWatch:
    """Finds single frozen sensors where no counter of the chip says whether a reading is new.

    A sensor is judged once its noise was seen: at nearly every sample one of its axes turns round.
    White noise of 0.6 steps of the converter does that, and repeats all three axes for FROZEN_S
    with a chance of 1e-20 at 150 Hz. Smaller noise turns too seldom, and so does a moved finger.

    Never judged is a sensor that has repeated for FROZEN_S before that: it repeats at rest. Where a
    repeat of a third of FROZEN_S ends by itself, the noise must be seen again.
    """

    def __init__(self, n_sensors: int, rate_hz: float) -> None:
        most = max(LEAST_SPAN, round(FROZEN_S * rate_hz))
        enough = max(LEAST_SPAN, round(NOISY_S * rate_hz))
        self._sensors = [_Liveness(most, enough) for _ in range(n_sensors)]
        self._frozen: BoolArray = np.zeros(n_sensors, np.bool_)
        self._is_lively = False

    def frozen(self, values: FloatArray, usable: BoolArray) -> BoolArray:
        """[S] which sensors are frozen after this sample; the next call overwrites the array.

        values: [C]. usable: [S]; a sample at which a sensor is not usable does not count for it.
        """
        # Python's own numbers, as in RepeatWatch
        here = usable.tolist()
        moved = []
        for sensor, reading, is_usable in zip(
            self._sensors, values.reshape(-1, 3).tolist(), here, strict=True
        ):
            moved.append(is_usable and sensor.moves_to(reading))
        # nearly every sample of a hand of noisy sensors ends here
        if self._is_lively and all(moved):
            return self._frozen

        for k, one in enumerate(self._sensors):
            if here[k]:
                self._frozen[k] = one.frozen(moved[k], any(moved))
        self._is_lively = all(one.is_lively for one in self._sensors)
        return self._frozen


class _Liveness:
    """What is known of one sensor of a FrozenWatch. most, enough: samples."""

    def __init__(self, most: int, enough: int) -> None:
        self._most = most
        self._enough = enough
        self._reading = self._change = self._before = [0.0, 0.0, 0.0]
        self._turns = 0
        # samples in a row that repeat, and those of them at which another sensor moved
        self._repeats = 0
        self._alone = 0
        self._is_noisy = False
        self._repeats_at_rest = False

    @property
    def is_lively(self) -> bool:
        """Whether its noise was seen and its last reading was another one."""
        return self._is_noisy and not self._repeats

    def moves_to(self, reading: list[float]) -> bool:
        """Take a reading; whether it is another one than the last."""
        if reading == self._reading:
            self._change = [0.0, 0.0, 0.0]
            return False
        (x, y, z), (was_x, was_y, was_z) = reading, self._reading
        self._change = [x - was_x, y - was_y, z - was_z]
        self._reading = reading
        return True

    def frozen(self, moved: bool, any_moved: bool) -> bool:
        """Whether the sensor is frozen after a sample at which it moved, or another one did."""
        turns = zip(self._before, self._change, strict=True)
        turned = any(before * change < 0.0 for before, change in turns)
        self._before = self._change
        if not moved:
            self._repeats = min(self._repeats + 1, self._most)
            self._alone = min(self._alone + any_moved, self._most)
        else:
            # a longer repeat is a frozen sensor that came back
            if self._most // 3 <= self._alone < self._most:
                self._is_noisy = False
                self._turns = 0
            self._repeats = self._alone = 0

        if not self._is_noisy and not self._repeats_at_rest:
            self._look_for_noise(turned)
        return self._is_noisy and self._alone >= self._most

    def _look_for_noise(self, turned: bool) -> None:
        self._turns = max(0, self._turns + (1 if turned else -2))
        self._is_noisy = self._turns >= self._enough
        self._repeats_at_rest = self._repeats >= self._most


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
