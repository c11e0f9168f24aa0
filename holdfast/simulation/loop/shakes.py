"""The hand itself moves: in its frame the object is accelerated the other way."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effect import Drawn, Effect
from holdfast.simulation.values import Parameter

FOREVER_S = 1e9
Span = tuple[float, float]
_COMPONENTS = 2


def _directions(rngs: Sequence[np.random.Generator]) -> FloatArray:
    """[3, B] a random unit vector for each lane."""
    raw = np.stack([rng.normal(size=3) for rng in rngs], axis=1)
    unit: FloatArray = raw / np.sqrt((raw * raw).sum(axis=0))
    return unit


class Arm:
    """Reaches of the arm, forth and back, with minimum jerk (Flash & Hogan, J. Neurosci. 5, 1985).

    x = amplitude (10 u^3 - 15 u^4 + 6 u^5), u = t / duration; acceleration
    amplitude / duration^2 (60 u - 180 u^2 + 120 u^3), m/s^2.
    """

    def __init__(
        self,
        drawn: Sequence[Drawn],
        trials: Sequence[object],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        self.along = _directions(rngs) * np.array([d["amplitude_m"] for d in drawn])
        names = ("at_s", "lasts_s", "rest_s")
        self.start_s, self.lasts_s, self.rest_s = (
            np.array([d[name] for d in drawn]) for name in names
        )
        self.count = np.round(np.array([d["count"] for d in drawn]))

    def _now(
        self, t_s: FloatArray, lane: int | slice
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(number, progress, direction) of the reach now; direction 0 before the first, after the
        last."""
        cycle = self.lasts_s[lane] + self.rest_s[lane]
        number = np.floor((t_s - self.start_s[lane]) / cycle)
        u = np.clip(
            (t_s - self.start_s[lane] - number * cycle) / self.lasts_s[lane], 0.0, 1.0
        )
        way = np.where(
            (number >= 0) & (number < self.count[lane]),
            np.where(number % 2 == 0, 1.0, -1.0),
            0.0,
        )
        return number, u, way

    def acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[3, B] of the hand."""
        _, u, way = self._now(t_s, slice(None))
        shape = (
            way * u * (60.0 - u * (180.0 - 120.0 * u)) / (self.lasts_s * self.lasts_s)
        )
        acceleration: FloatArray = self.along * shape
        return acceleration

    def motion_m(self, t_s: FloatArray, lane: int) -> FloatArray:
        """[T, 3] position of one lane's hand, from where it began."""
        number, u, way = self._now(t_s, lane)
        gone = u * u * u * (10.0 - u * (15.0 - 6.0 * u))
        before = np.clip(number, 0.0, self.count[lane]) % 2
        place: FloatArray = (before + way * gone)[:, None] * self.along[:, lane]
        return place

    def busy_s(self, lane: int) -> list[Span]:
        """Every reach."""
        cycle = self.lasts_s[lane] + self.rest_s[lane]
        starts = [self.start_s[lane] + k * cycle for k in range(int(self.count[lane]))]
        return [(start, start + self.lasts_s[lane]) for start in starts]


class Tremor:
    """Two sines of 4 to 12 Hz, random directions and phases, half the amplitude each, m/s^2.

    Frequencies of physiological and essential tremor: Elble & Koller, "Tremor", 1990.
    """

    def __init__(
        self,
        drawn: Sequence[Drawn],
        trials: Sequence[object],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        amplitude = np.array([d["amplitude_m_s2"] for d in drawn])
        self.along = [
            _directions(rngs) * (amplitude / _COMPONENTS) for _ in range(_COMPONENTS)
        ]
        self.phase = np.stack(
            [rng.uniform(0.0, 2.0 * np.pi, _COMPONENTS) for rng in rngs], axis=1
        )
        self.rate = 2.0 * np.pi * np.array([d["frequency_hz"] for d in drawn])
        self.detune = np.stack(
            [rng.uniform(0.85, 1.15, _COMPONENTS) for rng in rngs], axis=1
        )

    def acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[3, B] of the hand."""
        waves = np.sin(self.rate * self.detune * t_s + self.phase)
        total: FloatArray = self.along[0] * waves[0] + self.along[1] * waves[1]
        return total

    def busy_s(self, lane: int) -> list[Span]:
        """The whole trial."""
        return [(0.0, FOREVER_S)]


class Knock:
    """A blow to the hand: half a sine, peak in m/s^2; change of speed 2/pi peak * duration."""

    def __init__(
        self,
        drawn: Sequence[Drawn],
        trials: Sequence[object],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        self.along = _directions(rngs) * np.array([d["peak_m_s2"] for d in drawn])
        self.at_s, self.lasts_s = (
            np.array([d[name] for d in drawn]) for name in ("at_s", "lasts_s")
        )

    def acceleration_m_s2(self, t_s: FloatArray) -> FloatArray:
        """[3, B] of the hand."""
        u = (t_s - self.at_s) / self.lasts_s
        pulse = np.where(
            (u > 0.0) & (u < 1.0), np.sin(np.pi * np.clip(u, 0.0, 1.0)), 0.0
        )
        acceleration: FloatArray = self.along * pulse
        return acceleration

    def busy_s(self, lane: int) -> list[Span]:
        """The pulse and the time after it."""
        return [(self.at_s[lane] - 0.01, self.at_s[lane] + self.lasts_s[lane] + 0.3)]


ARM = Effect(
    "arm",
    "physics",
    make=Arm,
    parameters={
        "amplitude_m": Parameter(
            {"uniform": [0.05, 0.3]}, "m", 0, 2, "length of a reach"
        ),
        "lasts_s": Parameter({"uniform": [0.6, 1.5]}, "s", 0.1, 10, "time of a reach"),
        "rest_s": Parameter({"uniform": [0.3, 1.0]}, "s", 0, 60, "between reaches"),
        "at_s": Parameter(
            {"uniform": [4.2, 5.0]}, "s", 0, 600, "start of the first reach"
        ),
        "count": Parameter(2.0, "", 0, 1000, "reaches, alternately forth and back"),
    },
)
TREMOR = Effect(
    "tremor",
    "physics",
    make=Tremor,
    parameters={
        "frequency_hz": Parameter({"uniform": [4, 12]}, "Hz", 1, 30, "of the tremor"),
        "amplitude_m_s2": Parameter(
            {"uniform": [0.1, 1.0]}, "m/s^2", 0, 50, "of the hand's acceleration"
        ),
    },
)
KNOCK = Effect(
    "knock",
    "physics",
    make=Knock,
    parameters={
        "peak_m_s2": Parameter(
            {"uniform": [5, 40]}, "m/s^2", 0, 1000, "greatest acceleration"
        ),
        "lasts_s": Parameter({"uniform": [0.005, 0.03]}, "s", 0.001, 1, "of the pulse"),
        "at_s": Parameter({"uniform": [4.5, 6.0]}, "s", 0, 600, "start of the pulse"),
    },
)
