"""Energy of a step: what is stored where, and no lane ends with more than it had and was given."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.body import Body, State, offset_m, recess_m
from holdfast.simulation.effect import PhysicsEffects

TINY = 1e-300
"""Keeps a division by zero away."""


def kinetic_j(body: Body, state: State) -> FloatArray:
    """[B] energy of motion."""
    squares = state.velocity_m_s * state.velocity_m_s
    energy: FloatArray = 0.5 * body.mass_kg * (squares[0] + squares[1] + squares[2])
    return energy


def brush_j(body: Body, state: State) -> FloatArray:
    """[B] energy in the brushes."""
    y, z = state.stretch_m
    squares = y * y
    squares += z * z
    energy: FloatArray = 0.5 * np.einsum("eib,eib->b", body.brush_n_per_m, squares)
    return energy


def normal_j(
    body: Body, closure_m: FloatArray, x_m: FloatArray, recess: FloatArray
) -> FloatArray:
    """[B] energy in the normal springs, the object at x_m [B] and its surface recessed [S, B]."""
    depth = np.maximum(closure_m - recess - body.side * x_m, 0.0)
    energy: FloatArray = 0.5 * np.add.reduce(
        body.stiffness_n_per_m * (depth * depth), axis=0
    )
    return energy


def taken_by_lags_j(
    body: Body,
    old: State,
    state: State,
    closure_m: FloatArray,
    dt_s: FloatArray,
    effects: PhysicsEffects,
) -> FloatArray:
    """[B] energy that the object's own motion, not the fingers', puts into the lags."""
    was_m = np.maximum(closure_m - old.recess_m - body.side * old.position_m[0], 0.0)
    recess = recess_m(body, offset_m(body, state.position_m[1:]))
    depth_m = np.maximum(closure_m - recess - body.side * state.position_m[0], 0.0)
    taken_j = np.zeros_like(dt_s)
    for lag in effects.lags:
        stiffness, held_n = lag.terms(dt_s)
        push_n = np.where(
            state.normal_n > 0.0,
            held_n + stiffness * (depth_m - np.maximum(old.depth_m, 0.0)),
            0.0,
        )
        taken_j = taken_j + (push_n * (depth_m - was_m)).sum(axis=0)
    return taken_j


def keep_the_balance(
    body: Body, old: State, state: State, closure_m: FloatArray, given_j: FloatArray
) -> None:
    """Slow a lane that ended with more energy than it had and was given.

    Normals and brushes are solved one after the other, and the squeeze at the old place, so a long
    step can miss the balance; a fine step does not. Where stopping the object is not enough, it
    stays where it was.
    """
    state.offset_m = offset_m(body, state.position_m[1:])
    state.recess_m = recess_m(body, state.offset_m)
    had_j = (
        kinetic_j(body, old)
        + old.brush_j
        + normal_j(body, closure_m, old.position_m[0], old.recess_m)
    )
    moving_j, state.brush_j = kinetic_j(body, state), brush_j(body, state)
    still_j = state.brush_j + normal_j(
        body, closure_m, state.position_m[0], state.recess_m
    )
    too_much = (moving_j + still_j > had_j + given_j).nonzero()[0]
    if not too_much.size:
        return
    left_j = (had_j + given_j - still_j)[too_much]
    share = np.sqrt(np.maximum(left_j, 0.0) / np.maximum(moving_j[too_much], TINY))
    state.velocity_m_s[:, too_much] *= np.minimum(share, 1.0)
    stuck = too_much[left_j < 0.0]
    if not stuck.size:
        return
    state.position_m[:, stuck] = old.position_m[:, stuck]
    state.stretch_m[..., stuck] = (
        np.minimum(state.rho, 1.0)[..., stuck] * old.stretch_m[..., stuck]
    )
    state.brush_j[stuck] = brush_j(body, state)[stuck]
    state.offset_m[..., stuck], state.recess_m[..., stuck] = (
        old.offset_m[..., stuck],
        old.recess_m[..., stuck],
    )
