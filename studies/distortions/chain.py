"""Distortions of the sensors' chain: gain, noise, offsets, cross-talk, memory, resolution."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effects.effect import Plan, Rows
from studies.distortions.law import Memory, PlanRequest

LATEST_S = 2.6
"""Steps and faults come before the action, which begins at 2.9 s or later."""
EARLIEST_S = 1.6
"""They come when the hand holds the object."""
FULL_SCALE_N = 80.0
"""Range of a reading, N to either side: +-80 mT of the chip's z axis in its calibration."""


@dataclass(frozen=True)
class Memoryless:
    """A law whose rows do not depend on those before."""

    remembers = False

    def plan(self, request: PlanRequest) -> Plan:
        """Arrays by name."""
        raise NotImplementedError

    def values(self, values: FloatArray, plan: Plan) -> FloatArray:
        """[n, S, 3] distorted."""
        raise NotImplementedError

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """The values distorted; what is valid stays so."""
        return replace(rows, values=self.values(rows.values, plan)), None


@dataclass(frozen=True)
class Scaling(Memoryless):
    """Every reading times a gain: normal and shear. shear alone: `shear` times x and y."""

    gain: float = 1.0
    shear: float = 1.0

    def plan(self, request: PlanRequest) -> Plan:
        """Factors of x, y, z."""
        along = self.gain * self.shear
        return {"gain": np.array([along, along, self.gain])[None, None]}

    def values(self, values: FloatArray, plan: Plan) -> FloatArray:
        """Times the gain."""
        return values * plan["gain"]


@dataclass(frozen=True)
class GainsApart(Scaling):
    """Each sensor has a gain of its own, log-uniform from `lowest` to `highest`."""

    lowest: float = 0.4
    highest: float = 2.5

    def plan(self, request: PlanRequest) -> Plan:
        """A gain for each sensor."""
        low = np.log(self.lowest)
        high = np.log(self.highest)
        gains = np.exp(request.rng.uniform(low, high, request.sensors))
        return {"gain": gains[None, :, None]}


@dataclass(frozen=True)
class Addition(Memoryless):
    """Newtons of its own on every axis, whatever the reading."""

    def newtons(self, request: PlanRequest) -> FloatArray:
        """[T, S, 3] of every sample."""
        raise NotImplementedError

    def plan(self, request: PlanRequest) -> Plan:
        """The newtons of every sample."""
        return {"added_n": self.newtons(request)}

    def values(self, values: FloatArray, plan: Plan) -> FloatArray:
        """Plus the newtons."""
        return values + plan["added_n"]


@dataclass(frozen=True)
class Noise(Addition):
    """White noise, normal. rms_n: its standard deviation, N."""

    rms_n: float

    def newtons(self, request: PlanRequest) -> FloatArray:
        """Noise."""
        shape = (len(request.t_s), request.sensors, 3)
        return self.rms_n * request.rng.normal(size=shape)


@dataclass(frozen=True)
class OffsetStep(Addition):
    """Every axis moves by step_n up or down, all at one moment of the hold (a cable, a knock)."""

    step_n: float

    def newtons(self, request: PlanRequest) -> FloatArray:
        """0 before the moment."""
        signs = request.rng.choice([-1.0, 1.0], (request.sensors, 3))
        at_s = request.rng.uniform(EARLIEST_S, LATEST_S)
        is_after = request.t_s >= at_s
        return self.step_n * is_after[:, None, None] * signs


@dataclass(frozen=True)
class Drift(Addition):
    """Every axis drifts evenly up or down from the first sample on, n_s newtons a second."""

    n_s: float

    def newtons(self, request: PlanRequest) -> FloatArray:
        """The drift."""
        signs = request.rng.choice([-1.0, 1.0], (request.sensors, 3))
        return self.n_s * request.t_s[:, None, None] * signs


@dataclass(frozen=True)
class CrossTalk(Memoryless):
    """Each sensor also reads a share of the sensors before and after it."""

    share: float

    def plan(self, request: PlanRequest) -> Plan:
        """The mixing matrix of the sensors."""
        one_over = np.eye(request.sensors, k=1) + np.eye(request.sensors, k=-1)
        return {"mixing": (np.eye(request.sensors) + self.share * one_over)[None]}

    def values(self, values: FloatArray, plan: Plan) -> FloatArray:
        """Mixed."""
        return np.asarray(plan["mixing"] @ values)


@dataclass(frozen=True)
class Quantisation(Memoryless):
    """Rounded to whole steps of 2 FULL_SCALE_N / 2^bits."""

    bits: int

    @property
    def step_n(self) -> float:
        """One step, N."""
        return float(2.0 * FULL_SCALE_N / 2.0**self.bits)

    def plan(self, request: PlanRequest) -> Plan:
        """Nothing is drawn."""
        return {}

    def values(self, values: FloatArray, plan: Plan) -> FloatArray:
        """Rounded."""
        return np.rint(values / self.step_n) * self.step_n


@dataclass(frozen=True)
class Reversal:
    """Each magnet is upside down with probability 1/2: all three axes have the other sign.

    tared: the reading of the resting hand is already taken off before that, so that no sign of it
    is left for the preparation to see.
    """

    tared: bool = False
    remembers = True

    def plan(self, request: PlanRequest) -> Plan:
        """The sign of each sensor."""
        signs = request.rng.choice([-1.0, 1.0], request.sensors)
        return {"sign": signs[None, :, None]}

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """Times the sign; memory is the first reading."""
        first = rows.values if memory is None else memory
        values = rows.values
        if self.tared:
            values = values - first
        return replace(rows, values=values * plan["sign"]), first


@dataclass(frozen=True)
class Smoothing:
    """A low-pass of first order: a sample moves the reading a part of the way. tau_ms: its time."""

    tau_ms: float
    remembers = True

    def plan(self, request: PlanRequest) -> Plan:
        """The part of the way of one sample: 1 - exp(-T / tau)."""
        period_s = float(request.t_s[1] - request.t_s[0])
        part = 1.0
        if self.tau_ms > 0.0:
            part = -np.expm1(-1e3 * period_s / self.tau_ms)
        return {"part": np.full((1, 1, 1), part)}

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """Memory is the last output; it begins with the first reading."""
        last = rows.values if memory is None else memory
        now = last + plan["part"] * (rows.values - last)
        return replace(rows, values=now), now


@dataclass(frozen=True)
class Hysteresis:
    """Play: a reading follows only once the force has moved by half the width (in N) beyond it."""

    width_n: float
    remembers = True

    def plan(self, request: PlanRequest) -> Plan:
        """Nothing is drawn."""
        return {}

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """Memory is the last output; it begins with the first reading."""
        half = 0.5 * self.width_n
        last = rows.values if memory is None else memory
        now = np.clip(last, rows.values - half, rows.values + half)
        return replace(rows, values=now), now
