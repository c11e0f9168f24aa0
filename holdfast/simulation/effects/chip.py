"""The Hall chip (TMAG5273A1), its clock and its bus.

The chip averages, adds noise and has a resolution; samples come late.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.simulation.effects.effect import (
    Effect,
    Parameter,
    Plan,
    PlanRequest,
    Rows,
    Signal,
    added,
    as_drawn,
)

NOISE_UT = np.array([22.0, 22.0, 11.0])
"""1 sigma at 32 averaged conversions (data sheet SLYS045).

Its 125 and 68 uT at one conversion agree with 1/sqrt(32) within 10 %.
"""
RANGE_UT = np.array([40e3, 40e3, 80e3])
"""Range in x, y and z (data sheet SLYS045)."""
LATEST = 0.45
"""A sample is late or early by less than half a step, so the order is kept."""


def conversion_s(averages: float) -> float:
    """Time of one reading of three axes, s: 25 us * (3 axes * averages + 1).

    Source: TMAG5273 data sheet, table 7-4.
    """
    return 25e-6 * (3.0 * averages + 1.0)


def noise_plan(request: PlanRequest) -> Plan:
    """White noise of 22 uT in x and y and 11 uT in z at 32 averages, times sqrt(32 / averages)."""
    sigma = NOISE_UT * np.sqrt(32.0 / request["averages"])
    return {"added": sigma * request.noise()}


def quantisation(rows: Rows, plan: Plan) -> Rows:
    """Rounds to steps of 2 range / 2^bits: 19.5 uT in x, y and 39 uT in z at 12 bits."""
    step = 2.0 * RANGE_UT / 2.0 ** plan["bits"]
    return replace(rows, values=np.rint(rows.values / step) * step)


def late_plan(request: PlanRequest) -> Plan:
    """By how much each sample is late, s: normal with sd_ms; the first and the last are not."""
    latest_s = LATEST * float(request.t_s[1] - request.t_s[0])
    late_s = 1e-3 * request["sd_ms"] * request.rng.normal(size=len(request.t_s))
    late_s = np.clip(late_s, -latest_s, latest_s)
    # A recording keeps its ends, so that no value is taken from beyond them.
    late_s[[0, -1]] = 0.0
    return {"late_s": late_s}


def timing_jitter(signal: Signal, plan: Plan) -> Signal:
    """A sample is taken late or early; value and time stamp are of that moment."""
    late = plan["late_s"]
    if not late.any():
        return signal

    # Between two samples the value changes evenly.
    t_s = signal.t_s + late
    flat = signal.values.reshape(len(t_s), -1)
    columns = [np.interp(t_s, signal.t_s, column) for column in flat.T]
    values = np.stack(columns, axis=1)
    return replace(signal, t_s=t_s, values=values.reshape(signal.values.shape))


AVERAGES = Parameter(
    32.0, "", 1, 32, "conversions of each axis a reading is the mean of"
)
EFFECTS = {
    # Without averaging a reading is the force at its instant, and vibrations faster than half
    # the rate are aliased.
    "averaging": Effect(
        conversion_s,
        {"averages": AVERAGES},
        constant="averages",
        sets="average_s",
    ),
    "hall_noise": Effect(
        added,
        {"averages": AVERAGES},
        noise_plan,
        needs=("dipole",),
    ),
    "quantisation": Effect(
        quantisation,
        {
            "bits": Parameter(
                12.0, "", 4, 24, "number of steps of the whole range, as a power of 2"
            )
        },
        as_drawn,
        needs=("dipole",),
    ),
    "timing_jitter": Effect(
        timing_jitter,
        {"sd_ms": Parameter(0.3, "ms", 0, 20, "standard deviation of a sample's time")},
        late_plan,
        in_scene_unit=True,
        example={"sd_ms": 1.5},
        neutral={"sd_ms": 0},
    ),
}
