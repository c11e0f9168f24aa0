"""The Hall chip (TMAG5273A1): noise, range and resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simulation.effect import Drawn, Effect, Signal
from simulation.values import Parameter

NOISE_UT = np.array([22.0, 22.0, 11.0])
"""1 sigma at 32 averaged conversions (data sheet SLYS045).

Its 125 and 68 uT at one conversion agree with 1/sqrt(32) within 10 %.
"""
RANGE_UT = np.array([40e3, 40e3, 80e3])


def hall_noise(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """White noise of 22 uT in x and y and 11 uT in z at 32 averages, times sqrt(32 / averages)."""
    sigma = NOISE_UT * np.sqrt(32.0 / drawn["averages"])
    return replace(signal, values=signal.values + sigma * rng.normal(size=signal.values.shape))


def saturation(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """Beyond +-40 mT in x, y and +-80 mT in z the chip reports its limit; the sensor is invalid."""
    limit = RANGE_UT * drawn["range"]
    inside = (np.abs(signal.values) < limit).all(axis=2)
    return replace(
        signal, values=np.clip(signal.values, -limit, limit), valid=signal.valid & inside
    )


def quantisation(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """Rounds to steps of 2 range / 2^bits: 19.5 uT in x, y and 39 uT in z at 12 effective bits."""
    step = 2.0 * RANGE_UT / 2.0 ** drawn["bits"]
    return replace(signal, values=np.rint(signal.values / step) * step)


CHIP = (
    Effect(
        "hall_noise",
        "sensor",
        hall_noise,
        {
            "averages": Parameter(
                32.0, "", 1, 32, "conversions of each axis a reading is the mean of"
            )
        },
        needs=("dipole",),
    ),
    Effect(
        "saturation",
        "sensor",
        saturation,
        {"range": Parameter(1.0, "", 0.01, 2, "of the chip's range")},
        needs=("dipole",),
        marks_invalid=True,
    ),
    Effect(
        "quantisation",
        "sensor",
        quantisation,
        {"bits": Parameter(12.0, "", 4, 24, "of the whole range")},
        needs=("dipole",),
    ),
)
