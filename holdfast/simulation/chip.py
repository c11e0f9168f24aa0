"""The Hall chip (TMAG5273A1), its clock and its bus.

The chip averages, adds noise, and has a range and a resolution; samples come late, get lost, or
repeat while a sensor is stuck.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.simulation.effect import (
    SENSORS,
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
STALE_AFTER_S = 0.02
"""The driver calls a sensor stale when its reading has not changed for this long."""
LONGEST_BURST = 3
"""Rows that are lost in a row, at most."""
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


def saturation(rows: Rows, plan: Plan) -> Rows:
    """Beyond its range the chip reports its limit; the sensor is invalid.

    The range is +-40 mT in x, y and +-80 mT in z, times a factor.
    """
    limit = RANGE_UT * plan["range"]
    inside = (np.abs(rows.values) < limit).all(axis=2)
    clipped = np.clip(rows.values, -limit, limit)
    return replace(rows, values=clipped, valid=rows.valid & inside)


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


def kept_plan(request: PlanRequest) -> Plan:
    """Which samples come; the others are lost in bursts of 1 to 3 rows.

    The first two and the last come. At least two rows lie between bursts, then one begins with
    probability p at each row. So m / (m + 1 + 1 / p) of the rows are lost, m the mean length of a
    burst.
    """
    n = len(request.t_s)
    mean = 0.5 * (1 + LONGEST_BURST)
    share = request["share"]
    bursts = request.rng.integers(1, LONGEST_BURST + 1, n)
    # Solved for p: share = m / (m + 1 + 1 / p).
    probability = 0.0
    if share:
        probability = 1.0 / (mean / share - mean - 1.0)
    begins = request.rng.uniform(size=n) < probability
    kept = np.ones(n, dtype=np.bool_)
    last = -LONGEST_BURST

    for start in np.flatnonzero(begins):
        if start >= last + 2:
            last = min(start + bursts[start], n - 1)
            kept[max(start, 2) : last] = False

    return {"kept": kept}


def dropped_samples(signal: Signal, plan: Plan) -> Signal:
    """A share of the samples is lost."""
    kept = plan["kept"]
    values = signal.values[kept]
    return replace(
        signal, t_s=signal.t_s[kept], values=values, valid=signal.valid[kept]
    )


def stale_plan(request: PlanRequest) -> Plan:
    """From at_s on for lasts_s the sensors are stuck; the driver detects it after 20 ms."""
    begins_s = request["at_s"]
    ends_s = request["at_s"] + request["lasts_s"]

    stuck = np.zeros((len(request.t_s), request.sensors), dtype=np.bool_)
    during = (request.t_s >= begins_s) & (request.t_s < ends_s)
    stuck[:, request.places] = during[:, None]

    # The driver needs a while to see that a reading does not change.
    late = request.t_s - begins_s > STALE_AFTER_S
    return {"stuck": stuck, "detected": stuck & late[:, None]}


def stale_sensor(rows: Rows, plan: Plan, before: Rows) -> Rows:
    """A stuck sensor repeats its last value; it is invalid once the driver has detected it."""
    values = np.where(plan["stuck"][..., None], before.values, rows.values)
    return replace(rows, values=values, valid=rows.valid & ~plan["detected"])


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
    "saturation": Effect(
        saturation,
        {"range": Parameter(1.0, "", 0.01, 2, "of the chip's range")},
        as_drawn,
        needs=("dipole",),
        marks_invalid=True,
    ),
    "quantisation": Effect(
        quantisation,
        {"bits": Parameter(12.0, "", 4, 24, "of the whole range")},
        as_drawn,
        needs=("dipole",),
    ),
    "timing_jitter": Effect(
        timing_jitter,
        {"sd_ms": Parameter(0.3, "ms", 0, 20, "standard deviation of a sample's time")},
        late_plan,
        in_scene_unit=True,
    ),
    "dropped_samples": Effect(
        dropped_samples,
        {"share": Parameter(0.01, "", 0, 0.3, "share of the samples")},
        kept_plan,
        in_scene_unit=True,
    ),
    "stale_sensor": Effect(
        stale_sensor,
        {
            "sensors": SENSORS,
            "at_s": Parameter({"uniform": [4, 8]}, "s", 0, 1e6, "start"),
            "lasts_s": Parameter({"uniform": [0.1, 1]}, "s", 0, 1e6, "duration"),
        },
        stale_plan,
        chained=True,
        marks_invalid=True,
        in_scene_unit=True,
    ),
}
