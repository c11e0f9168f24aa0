"""The object turns about the thumb's axis: held off its centre of mass, it pivots in the grip."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.body import Body, State
from holdfast.simulation.core import MAX_SWEEPS, RHO_TOLERANCE, two_at_least
from holdfast.simulation.effect import Drawn, Effect
from holdfast.simulation.energy import TINY, brush_j
from holdfast.simulation.objects import Thing
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.values import Parameter


def gyration_m2(thing: Thing) -> float:
    """Moment of inertia about x over the mass, m^2.

    (b^2 + c^2) / 5 of an ellipsoid, R^2 / 4 + L^2 / 3 of a cylinder of half length L (Meriam &
    Kraige, "Engineering mechanics: dynamics", table D/4).
    """
    across, axial, half = (
        1e-3 * thing.radius_mm,
        1e-3 * thing.axial_radius_mm,
        1e-3 * thing.half_length_mm,
    )
    return (across**2 + axial**2) / 5.0 if axial else across**2 / 4.0 + half**2 / 3.0


class Rotation:
    """Angle about x, rad: I d(omega)/dt = offset x F - sum of p x f over the brushes.

    p is from the object's middle. F is the weight less what people and a box carry, who are assumed
    to hold the object at its centre of mass. So the object turns only while the hand holds it, and
    out of the hand it keeps its rate. I = m (gyration + offset^2), kg m^2.

    The brushes move by omega x p beside the core's translation. This step comes after the core's,
    implicit in omega, with the same reweighting and the same balance of energy (operator splitting:
    Strang, SIAM J. Numer. Anal. 5, 1968; first order here). The object does not turn at all while
    friction can hold it. Left out: the hand's own acceleration does not turn the object, and
    turning does not move its middle.
    """

    def __init__(
        self,
        drawn: Sequence[Drawn],
        trials: Sequence[PlannedTrial],
        rngs: Sequence[np.random.Generator],
    ) -> None:
        self.offset_m = (
            1e-3 * np.array([[d["offset_y_mm"], d["offset_z_mm"]] for d in drawn]).T
        )
        gyration = np.array([gyration_m2(trial.thing) for trial in trials])
        self.inertia_m2 = gyration + (self.offset_m * self.offset_m).sum(axis=0)
        self.angle, self.rate = np.zeros(len(drawn)), np.zeros(len(drawn))
        self.rho: FloatArray = np.ones(1)

    def turn(
        self, body: Body, state: State, limit_m: FloatArray, dt_s: FloatArray
    ) -> None:
        """Turn by one step; changes stretch, slip and energy of the brushes."""
        inertia = body.mass_kg * self.inertia_m2
        force_n = body.mass_kg * body.gravity_m_s2[1:] + state.agents_n[1:]
        force_n = np.where((state.normal_n > 0.0).any(axis=0), force_n, 0.0)
        place = self.place_m()
        drive = inertia * self.rate + dt_s * (
            place[0] * force_n[1] - place[1] * force_n[0]
        )
        lever = body.at_m - state.position_m[1:, None]
        across = np.stack(
            [-lever[1], lever[0]]
        )  # [2, S, B] d(y, z) of a turn by one radian
        damped = inertia + dt_s * self._damping(body, state, across, limit_m)
        rate, trial, length = self._solve(
            drive, damped, body.brush_n_per_m, state.stretch_m, across, limit_m, dt_s
        )
        had = (
            state.stretch_m,
            state.brush_j + 0.5 * inertia * self.rate * self.rate,
            self.angle,
            place,
        )
        state.stretch_m = self.rho * trial
        state.slip_m_s = state.slip_m_s + (1.0 - self.rho) * length / dt_s
        state.brush_j = brush_j(body, state)
        self.angle, self.rate = self.angle + rate * dt_s, rate
        self._keep_the_balance(body, state, inertia, force_n, had)

    def place_m(self) -> FloatArray:
        """[2, B] (y, z) of the centre of mass from the object's middle, turned."""
        cos, sin = np.cos(self.angle), np.sin(self.angle)
        y, z = self.offset_m
        turned: FloatArray = np.stack([cos * y - sin * z, sin * y + cos * z])
        return turned

    def busy_s(self, lane: int) -> list[tuple[float, float]]:
        """No interval of its own."""
        return []

    def _damping(
        self, body: Body, state: State, across: FloatArray, limit_m: FloatArray
    ) -> FloatArray:
        """[B] damping of the fingers along the surface, N m s/rad: of the elements that stick."""
        sticks = (self.rho == 1.0) & (state.slip_m_s == 0.0) & (limit_m > 0.0)
        stiff = np.where(sticks, body.brush_n_per_m, 0.0) * (across * across).sum(
            axis=0
        )
        coefficient: FloatArray = body.loss_s * stiff.sum(axis=(0, 1))
        return coefficient

    def _solve(
        self,
        drive: FloatArray,
        inertia: FloatArray,
        brush: FloatArray,
        stretch: FloatArray,
        across: FloatArray,
        limit: FloatArray,
        dt_s: FloatArray,
    ) -> tuple[FloatArray, FloatArray, FloatArray]:
        """(rate [B], trial stretch of the brushes, its length); reweights rho until it settles."""
        before = np.broadcast_to(self.rho, limit.shape)
        parts = (brush, stretch, across, limit, dt_s)
        rate, rho, trial, length = _sweep(drive, inertia, before, *parts)
        open_ = two_at_least(
            np.flatnonzero(np.abs(rho - before).max(axis=(0, 1)) > RHO_TOLERANCE)
        )
        for _ in range(MAX_SWEEPS):
            if not open_.size:
                break
            before = rho[..., open_]
            rate[open_], after, trial[..., open_], length[..., open_] = _sweep(
                drive[open_],
                inertia[open_],
                before,
                *(part[..., open_] for part in parts),
            )
            rho[..., open_] = after
            open_ = open_[np.abs(after - before).max(axis=(0, 1)) > RHO_TOLERANCE]
        self.rho = rho
        return rate, trial, length

    def _keep_the_balance(
        self,
        body: Body,
        state: State,
        inertia: FloatArray,
        force_n: FloatArray,
        had: tuple[FloatArray, FloatArray, FloatArray, FloatArray],
    ) -> None:
        """Slow a lane that ended with more energy than it had and was given, as the core does."""
        stretch, had_j, angle, place = had
        left_j = (
            had_j + (force_n * (self.place_m() - place)).sum(axis=0) - state.brush_j
        )
        moving_j = 0.5 * inertia * self.rate * self.rate
        share = np.sqrt(np.maximum(left_j, 0.0) / np.maximum(moving_j, TINY))
        self.rate = self.rate * np.minimum(share, 1.0)
        stuck = np.flatnonzero(left_j < 0.0)
        if not stuck.size:
            return
        self.angle[stuck] = angle[stuck]
        state.stretch_m[..., stuck] = self.rho[..., stuck] * stretch[..., stuck]
        state.brush_j[stuck] = brush_j(body, state)[stuck]


def _sweep(
    drive: FloatArray,
    inertia: FloatArray,
    rho: FloatArray,
    brush: FloatArray,
    stretch: FloatArray,
    across: FloatArray,
    limit: FloatArray,
    dt_s: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """One reweighting of the springs by rho: (rate [B], rho, stretch, its length)."""
    spring = brush * rho
    pull = (spring * (stretch * across[:, None]).sum(axis=0)).sum(axis=(0, 1))
    stiffness = (spring * (across * across).sum(axis=0)).sum(axis=(0, 1))
    rate = (drive - dt_s * pull) / (inertia + dt_s * dt_s * stiffness)
    trial = stretch + (across * (rate * dt_s))[:, None]
    length = np.sqrt(trial[0] * trial[0] + trial[1] * trial[1])
    return rate, np.minimum(1.0, limit / np.maximum(length, TINY)), trial, length


ROTATION = Effect(
    "rotation",
    "physics",
    make=Rotation,
    parameters={
        "offset_y_mm": Parameter(
            {"normal": [0, 5]}, "mm", -100, 100, "centre of mass off the grip, across"
        ),
        "offset_z_mm": Parameter(
            {"normal": [0, 15]}, "mm", -200, 200, "and along the object's axis"
        ),
    },
)
