"""How sensors of one design differ: shear gain, mounting, hysteresis, drift and noise.

A model that meets one gain, one way round and one level of noise learns them. These effects draw
them for every recording. Their ranges are wider than any one sensor's. For example:

    [effects.shear_gain]                 # a soft dome reads more of the shear than a stiff one
    gain = { uniform = [0.5, 1.2] }
    [effects.hysteresis]                 # silicone that does not come back all the way
    width_n = 0.05
    [effects.mounting]                   # each sensor glued in a few degrees off; left hands too
    spread_deg = 10
    [effects.drift]                      # needs record.unit = "N"
    rate_n_s = 0.02
    [effects.white_noise]                # needs record.unit = "N"
    rms_n = { uniform = [0, 0.04] }
    low_n = [0.003, 0.003, 0.02]         # further noise of each channel by itself: its rms is
    high_n = [0.01, 0.01, 0.04]          # log-uniform between these, one number a channel

The first three act on the force before the magnet, the last two on the force that is read. They
need no magnet: an ideal sensor of force can have each of them.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import (
    Effect,
    Parameter,
    Plan,
    PlanRequest,
    Rows,
    added,
    as_drawn,
)


def gain_plan(request: PlanRequest) -> Plan:
    """Each sensor's gain along the skin: that of the hand times 1 + spread n, n standard normal."""
    spread = 1.0 + request["spread"] * request.rng.normal(size=(1, request.sensors, 1))
    return {"gain": request["gain"] * np.maximum(spread, 0.1)}


def shear_gain(rows: Rows, plan: Plan) -> Rows:
    """Shear x and y of a sensor times its gain, felt over true; the normal force stays.

    Before a magnet's own curve, so with a `dipole` the sensor reads that share of what it would
    read. Silicone domes and magnets differ in how far they yield along the skin; the range is
    assumed, from shear over normal force in recordings of people (docs/scenes.md).
    """
    values = rows.values.copy()
    values[..., :2] *= plan["gain"]
    return replace(rows, values=values)


def mounting_plan(request: PlanRequest) -> Plan:
    """The angle of each sensor about its normal, and -1 where the hand is a left one."""
    apart = request.rng.normal(size=request.sensors)
    degrees = request["angle_deg"] + request["spread_deg"] * apart
    left = request.rng.uniform() < request["left_share"]
    angle = np.radians(degrees)
    return {
        "cos": np.cos(angle)[None],
        "sin": np.sin(angle)[None],
        "hand": np.full((1, 1), -1.0 if left else 1.0),
    }


def mounting(rows: Rows, plan: Plan) -> Rows:
    """x, y of a sensor turned about its normal: x cos - y sin, x sin + y cos; left: x mirrored.

    The same sensors in the mirrored hand see every force mirrored. Forces that the hand's frame
    turns (docs/scenes.md, a hand held any way) turn all sensors alike; this turns each by itself.
    """
    x = rows.values[..., 0] * plan["hand"]
    y = rows.values[..., 1]
    values = rows.values.copy()
    values[..., 0] = x * plan["cos"] - y * plan["sin"]
    values[..., 1] = x * plan["sin"] + y * plan["cos"]
    return replace(rows, values=values)


def hysteresis(rows: Rows, plan: Plan, before: Rows) -> Rows:
    """Play: a reading stays until the force has moved by half the width, then follows at that.

    reading = clip(reading before, force - width / 2, force + width / 2), N, on every axis. It
    depends on the order of the forces and not on their speed (Visintin, "Differential models of
    hysteresis", 1994, chapter 3); the memory with a time of silicone is the effect `lag`.
    """
    lowest, highest = _play(rows, plan)
    return replace(rows, values=np.clip(before.values, lowest, highest))


def _play(rows: Rows, plan: Plan) -> tuple[FloatArray, FloatArray]:
    """The lowest and the highest reading that a force allows, N."""
    half_n = 0.5 * plan["width_n"]
    return rows.values - half_n, rows.values + half_n


def hysteresis_of_trial(rows: Rows, plan: Plan) -> Rows:
    """The same of a whole trial, in one loop of two numpy calls a row."""
    lowest, highest = _play(rows, plan)
    values = np.empty_like(rows.values)
    reading = rows.values[0]
    for k in range(len(values)):
        np.maximum(reading, lowest[k], out=values[k])
        reading = values[k]
        np.minimum(reading, highest[k], out=reading)
    return replace(rows, values=values)


def drift_plan(request: PlanRequest) -> Plan:
    """Each axis of each sensor drifts at a rate of its own, N/s, and steps once at step_at_s, N.

    Rates and steps are uniform from minus to plus the drawn size. A bias that is learnt before the
    first touch takes off what there was until then. Sizes are assumed: 20 mN/s is 1.2 N a minute.
    """
    rates = request["rate_n_s"] * request.rng.uniform(
        -1.0, 1.0, (1, request.sensors, 3)
    )
    steps = request["step_n"] * request.rng.uniform(-1.0, 1.0, (1, request.sensors, 3))
    after = (request.t_s >= request["step_at_s"])[:, None, None]
    return {"added": rates * request.t_s[:, None, None] + after * steps}


def noise_plan(request: PlanRequest) -> Plan:
    """Normal noise on every axis of every sample, N.

    Its root mean square is rms_n: that of our own chips is 10 to 19 mN (`hall_noise`), of uSkin
    3 mN (human_slip_uskin, empty hand), and a model should not depend on either. Channels whose
    noise differs, as that of a transducer's normal force and load, have low_n and high_n besides.
    """
    rms_n = request["rms_n"]
    noise = request.noise()
    if "low_n" in request.drawn:
        shape = (1, request.sensors, 3)
        low, high = np.log([request["low_n"], request["high_n"]]).reshape(2, *shape)
        share = request.rng.uniform(size=shape)
        rms_n = np.hypot(rms_n, np.exp(low + share * (high - low)))
    return {"added": rms_n * noise}


EFFECTS = {
    "shear_gain": Effect(
        shear_gain,
        {
            "gain": Parameter(
                {"uniform": [0.5, 1.2]}, "", 0.05, 5, "shear felt over true"
            ),
            "spread": Parameter(0.05, "", 0, 0.5, "spread of the sensors' gains"),
        },
        gain_plan,
        neutral={"gain": 1, "spread": 0},
    ),
    "mounting": Effect(
        mounting,
        {
            "angle_deg": Parameter(
                0.0, "deg", -180, 180, "of all sensors about their normals"
            ),
            "spread_deg": Parameter(
                5.0, "deg", 0, 180, "spread of the sensors' angles"
            ),
            "left_share": Parameter(0.5, "", 0, 1, "share of left hands"),
        },
        mounting_plan,
        neutral={"angle_deg": 0, "spread_deg": 0, "left_share": 0},
    ),
    "hysteresis": Effect(
        hysteresis,
        {
            "width_n": Parameter(
                {"uniform": [0, 0.1]}, "N", 0, 10, "width of the loop"
            ),
        },
        as_drawn,
        hysteresis_of_trial,
        example={"width_n": 0.4},
        neutral={"width_n": 0},
    ),
    "drift": Effect(
        added,
        {
            "rate_n_s": Parameter(
                {"uniform": [0, 0.02]}, "N/s", 0, 10, "largest rate of an axis"
            ),
            "step_n": Parameter(0.0, "N", 0, 100, "largest step of an axis"),
            "step_at_s": Parameter({"uniform": [2, 8]}, "s", 0, 1e6, "when it steps"),
        },
        drift_plan,
        in_scene_unit=True,
        only_unit="N",
        example={"step_n": 0.3, "step_at_s": 0.2},
        neutral={"rate_n_s": 0, "step_n": 0},
    ),
    "white_noise": Effect(
        added,
        {
            "rms_n": Parameter(
                {"uniform": [0, 0.04]}, "N", 0, 10, "root mean square of every axis"
            ),
            "low_n": Parameter(
                None, "N", 1e-6, 10, "least of each channel's own", many=True
            ),
            "high_n": Parameter(
                None, "N", 1e-6, 10, "most of each channel's own", many=True
            ),
        },
        noise_plan,
        in_scene_unit=True,
        only_unit="N",
        by_channel=("low_n", "high_n"),
        neutral={"rms_n": 0},
    ),
}
