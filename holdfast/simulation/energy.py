"""Energy of a step: what is stored where, and no trial ends with more than it had and was given."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.body import Body, State, offset_m, recess_m
from holdfast.simulation.effect import PhysicsEffects

TINY = 1e-300
"""Keeps a division by zero away."""
add = np.add.reduce
"""As numpy's sum, whose wrapper costs as much as the sum of a small batch."""


def kinetic_j(body: Body, state: State) -> FloatArray:
    """[B] energy of motion."""
    squares = state.velocity_m_s * state.velocity_m_s
    square = squares[0] + squares[1] + squares[2]
    return 0.5 * body.mass_kg * square


def brush_j(body: Body, state: State) -> FloatArray:
    """[B] energy in the brushes."""
    y, z = state.stretch_m
    # In place: this array is as large as all brushes of the batch.
    squares = y * y
    squares += z * z
    return 0.5 * np.einsum("eib,eib->b", body.brush_n_per_m, squares)


def normal_j(
    body: Body, closure_m: FloatArray, x_m: FloatArray, recess: FloatArray
) -> FloatArray:
    """[B] energy in the normal springs, the object at x_m [B] and its surface recessed [S, B]."""
    depth = np.maximum(closure_m - recess - body.side * x_m, 0.0)
    doubled_j = body.stiffness_n_per_m * (depth * depth)
    return 0.5 * add(doubled_j, axis=0)


def _taken_by_lags_j(
    body: Body,
    old: State,
    state: State,
    closure_m: FloatArray,
    dt_s: FloatArray,
    effects: PhysicsEffects,
) -> FloatArray:
    """[B] energy that the object's own motion, not the fingers', puts into the lags."""
    # The fingers have closed already: what is left is the object's own way.
    place_before_m = body.side * old.position_m[0]
    was_m = np.maximum(closure_m - old.recess_m - place_before_m, 0.0)

    # The recess of the state is still that of the old place; the balance renews it later.
    recess = recess_m(body, offset_m(body, state.position_m[1:]))
    place_m = body.side * state.position_m[0]
    depth_m = np.maximum(closure_m - recess - place_m, 0.0)

    # The force of a lag depends on the whole change, its work on the object's part of it.
    change_m = depth_m - np.maximum(old.depth_m, 0.0)
    own_m = depth_m - was_m
    touching = state.normal_n > 0.0

    taken_j = np.zeros_like(dt_s)
    for lag in effects.lags:
        stiffness, held_n = lag.terms(dt_s)
        push_n = np.where(touching, held_n + stiffness * change_m, 0.0)
        taken_j = taken_j + (push_n * own_m).sum(axis=0)
    return taken_j


def keep_the_balance(
    body: Body, old: State, state: State, closure_m: FloatArray, given_j: FloatArray
) -> None:
    """Slow a trial that ended with more energy than it had and was given.

    Normals and brushes are solved one after the other, and the squeeze at the old place, so a long
    step can miss the balance; a fine step does not. Where stopping the object is not enough, it
    stays where it was.
    """
    state.offset_m = offset_m(body, state.position_m[1:])
    state.recess_m = recess_m(body, state.offset_m)

    # Both normal energies are at the new closure: the work of the fingers is not in the balance.
    normal_before_j = normal_j(body, closure_m, old.position_m[0], old.recess_m)
    had_j = kinetic_j(body, old) + old.brush_j + normal_before_j

    moving_j = kinetic_j(body, state)
    state.brush_j = brush_j(body, state)
    normal_after_j = normal_j(body, closure_m, state.position_m[0], state.recess_m)

    # Energy that stays even if the object stops.
    still_j = state.brush_j + normal_after_j
    has_j = moving_j + still_j
    allowed_j = had_j + given_j
    too_much = (has_j > allowed_j).nonzero()[0]
    if not too_much.size:
        return

    # The energy of motion grows with the square of the speed.
    left_j = (allowed_j - still_j)[too_much]
    ratio = np.maximum(left_j, 0.0) / np.maximum(moving_j[too_much], TINY)
    share = np.sqrt(ratio)
    state.velocity_m_s[:, too_much] *= np.minimum(share, 1.0)

    stuck = too_much[left_j < 0.0]
    if not stuck.size:
        return

    # At the old place the brushes keep what friction holds of their old stretch.
    # Their velocity is zero already, because no energy was left for it.
    held = np.minimum(state.rho, 1.0)[..., stuck]
    state.position_m[:, stuck] = old.position_m[:, stuck]
    state.stretch_m[..., stuck] = held * old.stretch_m[..., stuck]
    state.brush_j[stuck] = brush_j(body, state)[stuck]
    state.offset_m[..., stuck] = old.offset_m[..., stuck]
    state.recess_m[..., stuck] = old.recess_m[..., stuck]
