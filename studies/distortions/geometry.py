"""Distortions of where the sensors point: a hand held another way, a left hand, tilted fingertips.

Sensors of thumb and fingers face each other: the same direction in the world has y of the other
sign on the thumb. So the hand turned about the axis of its grip turns x, y of the thumb the other
way.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.hand_card import Side
from holdfast.simulation.effects.effect import Plan, Rows
from studies.distortions.law import Memory, PlanRequest


def turn(radians: FloatArray) -> FloatArray:
    """[.., 3, 3] turns of x, y about z by angles [..]."""
    cos = np.cos(radians)
    sin = np.sin(radians)
    matrix = np.zeros((*radians.shape, 3, 3))
    matrix[..., 0, 0] = cos
    matrix[..., 0, 1] = -sin
    matrix[..., 1, 0] = sin
    matrix[..., 1, 1] = cos
    matrix[..., 2, 2] = 1.0
    return matrix


def facing(sides: Sequence[Side]) -> FloatArray:
    """[S] 1 for the fingers and -1 for the thumb, which faces them."""
    return np.array([-1.0 if side == "thumb" else 1.0 for side in sides])


@dataclass(frozen=True)
class Rotation:
    """A law that multiplies each sensor's reading by a matrix of its own."""

    remembers = False

    def matrices(self, request: PlanRequest) -> FloatArray:
        """[S, 3, 3] of a trial."""
        raise NotImplementedError

    def plan(self, request: PlanRequest) -> Plan:
        """The matrices, the same for all samples."""
        return {"matrix": self.matrices(request)[None]}

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """Matrix times reading."""
        turned = (plan["matrix"] @ rows.values[..., None])[..., 0]
        return replace(rows, values=turned), None


@dataclass(frozen=True)
class HandRotation(Rotation):
    """The hand turned about the axis of its grip. degrees: None for any angle, drawn a trial."""

    degrees: float | None = None

    def matrices(self, request: PlanRequest) -> FloatArray:
        """By the angle on the fingers, by its negative on the thumb."""
        degrees = self.degrees
        if degrees is None:
            degrees = float(request.rng.uniform(0.0, 360.0))
        return turn(np.radians(degrees) * facing(request.sides))


@dataclass(frozen=True)
class AxesRotation(Rotation):
    """The x, y of all sensors turned alike about their normals, as by other boards in all tips."""

    degrees: float

    def matrices(self, request: PlanRequest) -> FloatArray:
        """By one angle, on the thumb too."""
        return turn(np.full(request.sensors, np.radians(self.degrees)))


@dataclass(frozen=True)
class SensorsRotation(Rotation):
    """Each sensor turned about its normal by an angle of its own, uniform from 0 to 360 degrees."""

    def matrices(self, request: PlanRequest) -> FloatArray:
        """By angles of their own."""
        return turn(request.rng.uniform(0.0, 2.0 * np.pi, request.sensors))


@dataclass(frozen=True)
class Mirror(Rotation):
    """A left hand that carries the model of a right one: x of every sensor has the other sign."""

    def matrices(self, request: PlanRequest) -> FloatArray:
        """x reversed."""
        mirror = np.diag([-1.0, 1.0, 1.0])
        return np.tile(mirror, (request.sensors, 1, 1))


@dataclass(frozen=True)
class Tilt(Rotation):
    """All fingertips tilted on the object, so that normal force and shear mix.

    axis: "x" for roll, "y" for pitch, about that axis of each sensor.
    """

    degrees: float
    axis: Literal["x", "y"]

    def matrices(self, request: PlanRequest) -> FloatArray:
        """By the angle on the fingers, by its negative on the thumb."""
        about_z = turn(np.radians(self.degrees) * facing(request.sides))
        # The axes of a turn about z, moved on by one or two, make one about x or y.
        steps = 1 if self.axis == "x" else 2
        return np.roll(about_z, steps, axis=(-2, -1))
