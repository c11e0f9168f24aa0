"""The Hall chip (TMAG5273A1): noise, range and resolution."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.simulation.effect import Drawn
from holdfast.simulation.sensor.rows import Plan, Rows, row_effect
from holdfast.simulation.values import Parameter

NOISE_UT = np.array([22.0, 22.0, 11.0])
"""1 sigma at 32 averaged conversions (data sheet SLYS045).

Its 125 and 68 uT at one conversion agree with 1/sqrt(32) within 10 %.
"""
RANGE_UT = np.array([40e3, 40e3, 80e3])


def noise_plan(drawn: Drawn, rng: np.random.Generator, t_s: FloatArray, sensors: int) -> Plan:
    """White noise of 22 uT in x and y and 11 uT in z at 32 averages, times sqrt(32 / averages)."""
    sigma = NOISE_UT * np.sqrt(32.0 / drawn["averages"])
    return {"noise_ut": sigma * rng.normal(size=(len(t_s), sensors, 3))}


def hall_noise(rows: Rows, plan: Plan) -> Rows:
    """Adds the noise."""
    return replace(rows, values=rows.values + plan["noise_ut"])


def range_plan(drawn: Drawn, rng: np.random.Generator, t_s: FloatArray, sensors: int) -> Plan:
    """The chip's range, +-40 mT in x, y and +-80 mT in z, times a factor."""
    return {"limit_ut": (RANGE_UT * drawn["range"])[None, None]}


def saturation(rows: Rows, plan: Plan) -> Rows:
    """Beyond its range the chip reports its limit; the sensor is invalid."""
    limit = plan["limit_ut"]
    inside = (np.abs(rows.values) < limit).all(axis=2)
    return Rows(np.clip(rows.values, -limit, limit), rows.valid & inside)


def bits_plan(drawn: Drawn, rng: np.random.Generator, t_s: FloatArray, sensors: int) -> Plan:
    """Steps of 2 range / 2^bits: 19.5 uT in x, y and 39 uT in z at 12 effective bits."""
    return {"step_ut": (2.0 * RANGE_UT / 2.0 ** drawn["bits"])[None, None]}


def quantisation(rows: Rows, plan: Plan) -> Rows:
    """Rounds to whole steps."""
    step = plan["step_ut"]
    return replace(rows, values=np.rint(rows.values / step) * step)


CHIP = (
    row_effect(
        "hall_noise",
        noise_plan,
        hall_noise,
        parameters={
            "averages": Parameter(
                32.0, "", 1, 32, "conversions of each axis a reading is the mean of"
            )
        },
        needs=("dipole",),
    ),
    row_effect(
        "saturation",
        range_plan,
        saturation,
        parameters={"range": Parameter(1.0, "", 0.01, 2, "of the chip's range")},
        needs=("dipole",),
        marks_invalid=True,
    ),
    row_effect(
        "quantisation",
        bits_plan,
        quantisation,
        parameters={"bits": Parameter(12.0, "", 4, 24, "of the whole range")},
        needs=("dipole",),
    ),
)
