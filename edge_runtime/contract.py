"""The whole domain on two screens: what comes in, what goes out, and the words for it.

A *sample* is one reading of all sensors. Each sensor is a 3-axis Hall fingertip, and its three
channels stand together: shear x, shear y, normal z. Six fingertips give 18 channels; any other
multiple of three works (a 4x4 pad gives 48). A *recording* is samples at one rate, in one unit.

The *situation* says what the hand is in; the *class* adds whether the object is light or heavy::

    situation      class ids   meaning
    nothing        0 / 1       no contact
    grasp          2 / 3       the moment of grasping, and steady holding
    safe_slip      4 / 5       voluntary: pass, put-down, release; no action wanted
    risky_slip     6 / 7       involuntary: pull, fall; action wanted

Even ids are light objects (under 150 g), odd ids heavy ones. The numbers grow with risk, so the
rule for ties (the riskier one wins) is "the higher number wins" everywhere.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

import numpy as np
import numpy.typing as npt

AXES = ("x", "y", "z")
NORMAL_AXIS = 2
SITUATIONS = ("nothing", "grasp", "safe_slip", "risky_slip")
CLASSES = tuple(f"{situation}_{weight}" for situation in SITUATIONS for weight in ("light", "heavy"))
LIGHT_BELOW_G = 150.0

NOTHING, GRASP, SAFE_SLIP, RISKY_SLIP = range(4)

Unit = Literal["N", "uT", "count"]
UNITS: tuple[Unit, ...] = ("N", "uT", "count")
State = Literal["unknown", "nothing", "grasp", "safe_slip", "risky_slip"]

FloatArray = npt.NDArray[np.float64]
BoolArray = npt.NDArray[np.bool_]

RATE_TOLERANCE = 0.10
"""A source may run within +-10 % of the rate a model was built for (median step)."""


def class_id(situation: int, *, heavy: bool) -> int:
    """Eight-class id of a situation index and a weight."""
    return 2 * situation + int(heavy)


def channel_names(n_sensors: int) -> tuple[str, ...]:
    """Channel names in order: X1, Y1, Z1 .. Xn, Yn, Zn."""
    return tuple(f"{axis.upper()}{k}" for k in range(1, n_sensors + 1) for axis in AXES)


@dataclass(frozen=True)
class Sample:
    """One reading of all sensors.

    t_ns: acquisition time, monotonic, ns. values: [C] in the unit of the source.
    valid: [C/3], False where the driver knows that a sensor is lost, stale or saturated.
    sequence: counts samples from 0, gaps show losses.
    """

    t_ns: int
    values: FloatArray
    valid: BoolArray
    sequence: int


@dataclass(frozen=True)
class Prediction:
    """What the hand is told at one sample (the output contract; one JSON line each).

    t_acquired_ns, t_decided_ns, latency_us: monotonic clock. p_situation: the four situations, always.
    p_class and weight: None where the model knows no weight, and in "nothing" and "unknown".
    state: "unknown" whenever fewer sensors than the model needs are usable and settled, or all repeat themselves.
    extra: further heads by name, such as p_risky_250ms. detectors: which classical detectors fire.
    arm, act: the decision's debounced request. degraded: some sensor is missing, yet enough are left.
    """

    sequence: int
    t_acquired_ns: int
    t_decided_ns: int
    latency_us: float
    state: State
    p_situation: dict[str, float]
    p_risky: float
    p_class: dict[str, float] | None
    weight: Literal["light", "heavy"] | None
    extra: dict[str, float]
    detectors: dict[str, bool]
    arm: bool
    act: bool
    degraded: bool
    settled: bool
    model_id: str
