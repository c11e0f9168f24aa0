"""Clock and bus: late, lost and repeated samples."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from simulation.effect import Drawn, Effect, Signal
from simulation.values import Parameter

STALE_AFTER_S = 0.02
LONGEST_BURST = 3
LATEST = 0.45
"""A sample is late or early by less than half a step, so the order is kept."""


def timing_jitter(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """A sample is taken at t + e, e normal with sd_ms; value and time stamp are of that moment."""
    step_s = float(signal.t_s[1] - signal.t_s[0])
    late_s = np.clip(
        1e-3 * drawn["sd_ms"] * rng.normal(size=len(signal.t_s)), -LATEST * step_s, LATEST * step_s
    )
    late_s[[0, -1]] = 0.0
    if not late_s.any():
        return signal
    t_s = signal.t_s + late_s
    flat = signal.values.reshape(len(t_s), -1)
    values = np.stack([np.interp(t_s, signal.t_s, column) for column in flat.T], axis=1)
    return replace(signal, t_s=t_s, values=values.reshape(signal.values.shape))


def dropped_samples(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """A share of the samples is lost, in bursts of 1 to 3 rows; the first two and the last stay.

    At least two rows lie between bursts, then one begins with probability p at each row. So
    m / (m + 1 + 1 / p) of the rows are lost, m the mean length of a burst.
    """
    n, mean = len(signal.t_s), 0.5 * (1 + LONGEST_BURST)
    bursts = rng.integers(1, LONGEST_BURST + 1, n)
    share = drawn["share"]
    begins = rng.uniform(size=n) < (1.0 / (mean / share - mean - 1.0) if share else 0.0)
    kept = np.ones(n, dtype=np.bool_)
    last = -LONGEST_BURST
    for start in np.flatnonzero(begins):
        if start >= last + 2:
            last = min(start + bursts[start], n - 1)
            kept[max(start, 2) : last] = False
    return replace(
        signal, t_s=signal.t_s[kept], values=signal.values[kept], valid=signal.valid[kept]
    )


def stale_sensor(signal: Signal, drawn: Drawn, rng: np.random.Generator) -> Signal:
    """From at_s on for lasts_s a sensor repeats its last value.

    After 20 ms the driver detects it, and the sensor is invalid.
    """
    values, valid = signal.values.copy(), signal.valid.copy()
    stuck = np.flatnonzero(
        (signal.t_s >= drawn["at_s"]) & (signal.t_s < drawn["at_s"] + drawn["lasts_s"])
    )
    known = stuck[signal.t_s[stuck] - drawn["at_s"] > STALE_AFTER_S] if stuck.size else stuck
    for number in drawn["sensors"] if stuck.size else ():
        values[stuck, int(number) - 1] = values[max(stuck[0] - 1, 0), int(number) - 1]
        valid[known, int(number) - 1] = False
    return replace(signal, values=values, valid=valid)


TIMING = (
    Effect(
        "timing_jitter",
        "sensor",
        timing_jitter,
        {"sd_ms": Parameter(0.3, "ms", 0, 20, "standard deviation of a sample's time")},
        in_card_unit=True,
    ),
    Effect(
        "dropped_samples",
        "sensor",
        dropped_samples,
        {"share": Parameter(0.01, "", 0, 0.3, "share of the samples")},
        in_card_unit=True,
    ),
    Effect(
        "stale_sensor",
        "sensor",
        stale_sensor,
        {
            "sensors": Parameter([], "", 1, 6, "which sensors", many=True),
            "at_s": Parameter({"uniform": [4, 8]}, "s", 0, 1e6, "start"),
            "lasts_s": Parameter({"uniform": [0.1, 1]}, "s", 0, 1e6, "duration"),
        },
        marks_invalid=True,
        in_card_unit=True,
    ),
)
