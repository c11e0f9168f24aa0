"""The object turns about the thumb's axis: a weight off the middle of the grip pivots in it."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from edge_runtime.contract import FloatArray
from simulation.core import TINY, Body, State, brush_j
from simulation.effect import Drawn, Effect
from simulation.values import Parameter

SWEEPS = 4


class Rotation:
    """Angle about x (rad): I d(omega)/dt = m g x offset - sum of p x f over the brushes, p from the object's middle.

    The brushes feel omega x p beside the core's translation; after the core's step this one is made by itself,
    implicit in omega and with the same reweighting (operator splitting: each part takes energy out, none puts any
    in). Inertia I = m (0.4 R^2 + offset^2), R the radius: kg m^2. It holds exactly while friction can.
    """

    def __init__(self, drawn: Sequence[Drawn], trials: Sequence[object], rngs: Sequence[np.random.Generator]) -> None:
        lanes = len(drawn)
        self.offset_m = 1e-3 * np.array([[d["offset_y_mm"], d["offset_z_mm"]] for d in drawn]).T
        radius_m = 1e-3 * np.array([getattr(trial, "thing").radius_mm for trial in trials])  # noqa: B009
        self.gyration_m2 = 0.4 * radius_m**2 + (self.offset_m * self.offset_m).sum(axis=0)
        self.angle, self.rate = np.zeros(lanes), np.zeros(lanes)

    def turn(self, body: Body, state: State, limit_m: FloatArray, dt_s: FloatArray) -> None:
        """Turn by one step; changes the brushes' stretch and slip and the energy in them."""
        inertia = body.mass_kg * self.gyration_m2
        lever = body.at_m - state.position_m[1:, None]  # [2, 6, B]
        across = np.stack([-lever[1], lever[0]])  # d(y, z) of a turn by one radian
        place = self._offset()
        weight = body.mass_kg * (place[0] * body.gravity_m_s2[2] - place[1] * body.gravity_m_s2[1])
        drive = inertia * self.rate + dt_s * weight
        rho = np.ones_like(limit_m)
        for _ in range(SWEEPS):
            spring = body.brush_n_per_m * rho
            pull = (spring * (state.stretch_m * across[:, None]).sum(axis=0)).sum(axis=(0, 1))
            stiffness = (spring * (across * across).sum(axis=0)).sum(axis=(0, 1))
            rate = (drive - dt_s * pull) / (inertia + dt_s * (dt_s + body.loss_s) * stiffness)
            trial = state.stretch_m + (across * (rate * dt_s))[:, None]
            length = np.sqrt(trial[0] * trial[0] + trial[1] * trial[1])
            rho = np.minimum(1.0, limit_m / np.maximum(length, TINY))
        state.stretch_m = rho * trial
        state.slip_m_s = state.slip_m_s + (1.0 - rho) * length / dt_s
        state.brush_j = brush_j(body, state)
        self.angle, self.rate = self.angle + rate * dt_s, rate

    def _offset(self) -> FloatArray:
        """[2, B] the centre of mass from the middle, turned."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        y, z = self.offset_m
        turned: FloatArray = np.stack([cos * y - sin * z, sin * y + cos * z])
        return turned

    def busy_s(self, lane: int) -> list[tuple[float, float]]:
        """Nothing of its own."""
        return []


ROTATION = Effect(
    "rotation",
    "physics",
    make=Rotation,
    parameters={
        "offset_y_mm": Parameter({"normal": [0, 5]}, "mm", -100, 100, "centre of mass beside the grip, across"),
        "offset_z_mm": Parameter({"normal": [0, 15]}, "mm", -200, 200, "and along the object's axis"),
    },
)
