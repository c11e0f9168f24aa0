"""The hand is not still: it moves, which accelerates the object in its frame; its grip swings."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import (
    Drawn,
    Effect,
    EffectBatch,
    Interval,
    Parameter,
    PhysicsEffect,
)
from holdfast.simulation.effects.smooth import smooth, smooth_change

FOREVER_S = 1e9
"""Longer than any trial."""
RIPPLES = 3
"""Sines of an unsteady grip."""
WAVES = 2
"""Sines of a tremor."""


def _directions(rngs: Sequence[np.random.Generator]) -> FloatArray:
    """[3, B] a random unit vector for each trial."""
    # Normal in every axis, so that no direction is preferred.
    raw = np.stack([rng.normal(size=3) for rng in rngs], axis=1)
    length = np.sqrt((raw * raw).sum(axis=0))
    return raw / length


def _uniform(
    rngs: Sequence[np.random.Generator], count: int, low: float, high: float
) -> Any:
    """[count, B] draws of each trial."""
    return np.stack([rng.uniform(low, high, count) for rng in rngs], axis=1)


class Arm(PhysicsEffect):
    """Reaches of the arm, forth and back, with minimum jerk (Flash & Hogan, J. Neurosci. 5, 1985).

    x = amplitude (10 u^3 - 15 u^4 + 6 u^5), u = t / duration; acceleration
    amplitude / duration^2 (60 u - 180 u^2 + 120 u^3), m/s^2.

    along    [3, B] direction of the reaches times their length, m
    start_s  [B] of the first reach
    lasts_s  [B] duration of a reach
    cycle_s  [B] from one reach to the next
    count    [B] reaches
    """

    kind = "shakes"

    def __init__(self, batch: EffectBatch) -> None:
        self.along = _directions(batch.rngs) * batch.values("amplitude_m")
        self.start_s = batch.values("at_s")
        self.lasts_s = batch.values("lasts_s")
        self.cycle_s = self.lasts_s + batch.values("rest_s")
        self.count = np.round(batch.values("count"))

    def _reach(
        self, t_s: FloatArray, of: int | slice
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(number, progress 0 .. 1, direction +-1) of the reach at t_s, of some trials.

        The direction is 0 before the first reach and after the last.
        """
        cycle_s = self.cycle_s[of]
        since_s = t_s - self.start_s[of]

        # Reach and rest together are a cycle; the hand rests after u has reached 1.
        number = np.floor(since_s / cycle_s)
        within_s = since_s - number * cycle_s
        u = np.clip(within_s / self.lasts_s[of], 0.0, 1.0)
        reaches = (number >= 0) & (number < self.count[of])

        # Even reaches go forth, odd ones back.
        direction = np.where(number % 2 == 0, 1.0, -1.0)
        return number, u, np.where(reaches, direction, 0.0)

    def acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[3, B] of the hand."""
        _, u, direction = self._reach(t_s, slice(None))
        # The second derivative of the path by u, then by time.
        by_u = direction * smooth_change(u)
        by_time = by_u / (self.lasts_s * self.lasts_s)
        return self.along * by_time

    @staticmethod
    def peak_m_s2(drawn: Drawn) -> float:
        """Where u (60 - 180 u + 120 u^2) is largest: u = 1/2 - 1/sqrt(12), 10 / sqrt(3)."""
        lasts_s = float(drawn["lasts_s"])
        return 10.0 / np.sqrt(3.0) * float(drawn["amplitude_m"]) / lasts_s**2

    def motion_m(self, t_s: FloatArray, trial: int) -> FloatArray:
        """[T, 3] position of one trial's hand, from where it began."""
        number, u, direction = self._reach(t_s, trial)
        # After an odd number of reaches the hand is at the far end.
        before = np.clip(number, 0.0, self.count[trial]) % 2
        share = before + direction * smooth(u)
        return share[:, None] * self.along[:, trial]

    def busy_s(self, trial: int) -> list[Interval]:
        """The intervals of its reaches, in s; the rests between them are left out."""
        first_s = self.start_s[trial]
        cycle_s = self.cycle_s[trial]
        lasts_s = self.lasts_s[trial]

        intervals = []
        for k in range(int(self.count[trial])):
            start_s = first_s + k * cycle_s
            intervals.append((start_s, start_s + lasts_s))
        return intervals


class Tremor(PhysicsEffect):
    """Two sines of 4 to 12 Hz, random directions and phases, half the amplitude each, m/s^2.

    Frequencies of physiological and essential tremor: Elble & Koller, "Tremor", 1990.

    along   for each sine [3, B] its direction times its amplitude, m/s^2
    phase   [WAVES, B] rad
    rate    [B] the angular frequency that both are near, rad/s
    detune  [WAVES, B] factor of it
    """

    kind = "shakes"

    def __init__(self, batch: EffectBatch) -> None:
        amplitude = batch.values("amplitude_m_s2") / WAVES
        # The order of these draws is part of the format of simulated sets.
        self.along = [_directions(batch.rngs) * amplitude for _ in range(WAVES)]
        self.phase = _uniform(batch.rngs, WAVES, 0.0, 2.0 * np.pi)
        self.rate = 2.0 * np.pi * batch.values("frequency_hz")
        self.detune = _uniform(batch.rngs, WAVES, 0.85, 1.15)

    @staticmethod
    def peak_m_s2(drawn: Drawn) -> float:
        """Both sines at their peaks, in one direction."""
        return float(drawn["amplitude_m_s2"])

    def acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[3, B] of the hand."""
        # Two close frequencies beat, so the amplitude waxes and wanes as that of a real tremor.
        angle = self.rate * self.detune * t_s + self.phase
        waves = np.sin(angle)
        return self.along[0] * waves[0] + self.along[1] * waves[1]

    def busy_s(self, trial: int) -> list[Interval]:
        return [(0.0, FOREVER_S)]


class Fluctuation(PhysicsEffect):
    """The grip force is never quite steady: it swings slowly by a share of itself.

    closure = steady closure (1 + share sqrt(2 / n) sum of n sines); the normal springs are linear,
    so `share` is the standard deviation of the force over its mean. 2 to 4 % in people who hold a
    force: Jones, Hamilton & Wolpert, J. Neurophysiol. 88, 2002.

    rate   [RIPPLES, B] angular frequencies, rad/s
    phase  [RIPPLES, B] rad
    size   [B] amplitude of each sine
    """

    kind = "grips"

    def __init__(self, batch: EffectBatch) -> None:
        low_hz = batch.values("from_hz")
        wide_hz = batch.values("to_hz") - low_hz
        # The order of these draws is part of the format of simulated sets.
        places = _uniform(batch.rngs, RIPPLES, 0.0, 1.0)
        turns = _uniform(batch.rngs, RIPPLES, 0.0, 1.0)
        self.rate = 2.0 * np.pi * (low_hz + wide_hz * places)
        self.phase = 2.0 * np.pi * turns
        self.size = batch.values("share") * np.sqrt(2.0 / RIPPLES)

    def closure_m(self, closure_m: FloatArray, t_s: FloatArray) -> FloatArray:
        """[S, B] closure of unsteady fingers; open ones stay where they are."""
        waves = np.sin(self.rate * t_s + self.phase)
        swing = 1.0 + self.size * waves.sum(axis=0)
        return np.where(closure_m > 0.0, closure_m * swing, closure_m)


EFFECTS = {
    "arm": Effect(
        Arm,
        {
            "amplitude_m": Parameter(
                {"uniform": [0.05, 0.3]}, "m", 0, 2, "length of a reach"
            ),
            "lasts_s": Parameter(
                {"uniform": [0.6, 1.5]}, "s", 0.1, 10, "time of a reach"
            ),
            "rest_s": Parameter({"uniform": [0.3, 1.0]}, "s", 0, 60, "between reaches"),
            "at_s": Parameter(
                {"uniform": [4.2, 5.0]}, "s", 0, 600, "start of the first reach"
            ),
            "count": Parameter(2.0, "", 0, 1000, "reaches, alternately forth and back"),
        },
    ),
    "tremor": Effect(
        Tremor,
        {
            "frequency_hz": Parameter({"uniform": [4, 12]}, "Hz", 1, 30, "frequency"),
            "amplitude_m_s2": Parameter(
                {"uniform": [0.1, 1.0]},
                "m/s^2",
                0,
                50,
                "peak of the hand's acceleration",
            ),
        },
    ),
    "fluctuation": Effect(
        Fluctuation,
        {
            "share": Parameter(0.03, "", 0, 0.3, "standard deviation over the grip"),
            "from_hz": Parameter(0.5, "Hz", 0.01, 30, "lowest frequency"),
            "to_hz": Parameter(3.0, "Hz", 0.01, 30, "highest frequency"),
        },
    ),
}
