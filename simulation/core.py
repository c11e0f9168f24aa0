"""The core: brush contacts on an object in three dimensions, one implicit step, many trials at
once.

Six contacts, unless a card asks for a hand with more (hand.py).

Hand frame: x from the thumb to the fingers (contact normal), y across, z along the object's axis,
upwards; origin where the object is taken. Arrays are [.., B] with trials (lanes) last; every lane
has a step of its own.

Contact i (those of the thumb, then the fingers') presses by how deep its finger is closed into the
object:

    depth_i = closure_i(t) - s_i x - r_i,   r_i = (curvature_y dy^2 + curvature_z dz^2) / 2,   s = +1 thumb, -1 finger
    N_i = max(0, k_i depth_i + c_i d(depth_i)/dt)

so on a curved object that moves by d the normal falls by k d^2/2R, and the same energy pushes it
out with N d/R. Along the surface a contact is a brush of E elements: spring k_e, deflection u, and
|k_e u| <= mu N_e (Coulomb, set-valued: no motion below the limit at all); mu falls from static to
kinetic with slip speed (Stribeck).

One step of length dt is implicit in the velocity (backward Euler): first x with the normals, then y
and z with the brushes. With |k u| bounded, the second is the minimum of a convex function whose
springs are those of Huber; it is found by reweighting them, rho = min(1, limit / |k (u + v dt)|),
until rho stands still (Huber & Ronchetti, "Robust statistics", 2009, 7.8). Backward Euler cannot
gain energy from convex springs at any dt; the squeeze of a curved object is concave and is taken at
the old place for the same reason (Eyre, "Unconditionally gradient stable time marching", 1998).
Friction by return mapping: Simo & Hughes, "Computational inelasticity", 1998, chapter 1.
"""

from __future__ import annotations

from copy import copy
from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt

from edge_runtime.contract import FloatArray
from simulation.effect import NO_EFFECTS, PhysicsEffects

IntArray = npt.NDArray[np.int64]
TINY = 1e-300
RHO_TOLERANCE = 2e-3
MAX_SWEEPS = 60


@cache
def sides(contacts: int, thumb: int) -> FloatArray:
    """[S, 1] which way a contact pushes the object: the thumb's, which come first, along x, the
    fingers' against it."""
    return np.where(np.arange(contacts) < thumb, 1.0, -1.0)[:, None]


SIDE = sides(6, 2)
"""Of the thesis' hand: two of the thumb, then index, middle, ring, little."""


@dataclass(frozen=True)
class Body:
    """What is held and by what: constants of a batch.

    mass_kg [B]; gravity_m_s2 [3, B]; curvature_per_m [2, B]; straight_m [B] (half length of a
    cylinder, 0: ball); at_m [2, 6, B]: where in the hand a contact sits (y, z), from where it meets
    the apex or the middle of the object; stiffness_n_per_m, damping_n_s_per_m [6, B]: normal;
    brush_n_per_m [E, 6, B]: each element's spring; pressure [E, 1, 1]: share of the normal an
    element bears; static, kinetic [B]: friction; stribeck_m_s: slip speed at which friction is half
    way; loss_s: a finger's damping along the surface over its stiffness (none in sliding); thumb:
    how many of the contacts, the first, are the thumb's. 6 here and below is S where a hand has S
    contacts.
    """

    mass_kg: FloatArray
    gravity_m_s2: FloatArray
    curvature_per_m: FloatArray
    straight_m: FloatArray
    at_m: FloatArray
    stiffness_n_per_m: FloatArray
    damping_n_s_per_m: FloatArray
    brush_n_per_m: FloatArray
    pressure: FloatArray
    static: FloatArray
    kinetic: FloatArray
    stribeck_m_s: float = 2e-3
    loss_s: float = 2e-3
    thumb: int = 2

    @property
    def side(self) -> FloatArray:
        """[S, 1] which way each contact pushes."""
        return sides(len(self.stiffness_n_per_m), self.thumb)


@dataclass(frozen=True)
class Pull:
    """A person: a damped spring to a moving target that never pulls harder than cap_n, and a share
    of the weight.

    stiffness_n_per_m, damping_n_s_per_m, cap_n, weight_share [B]; target_m, target_m_s [3, B].
    """

    stiffness_n_per_m: FloatArray
    damping_n_s_per_m: FloatArray
    cap_n: FloatArray
    weight_share: FloatArray
    target_m: FloatArray
    target_m_s: FloatArray


@dataclass(frozen=True)
class Floor:
    """A box from below: a unilateral spring at height_m [B] that pushes with at most cap_n [B], and
    hardly slides."""

    stiffness_n_per_m: float
    damping_n_s_per_m: float
    sideways_n_s_per_m: float
    height_m: FloatArray
    cap_n: FloatArray


@dataclass(frozen=True)
class Inputs:
    """What the hand and its surroundings do during one step: closure_m [6, B] at its end, people, a
    box."""

    closure_m: FloatArray
    people: tuple[Pull, ...] = ()
    floor: Floor | None = None


@dataclass
class State:
    """Where everything is: position_m, velocity_m_s [3, B]; stretch_m [2, E, 6, B] of the brush
    elements.

    rho [E, 6, B]: share of a trial stretch that friction could hold in the last step; slip_m_s [E,
    6, B]; depth_m, normal_n [6, B]; agents_n [3, B]: what people and the box did to the object in
    the last step; brush_j [B]: energy in the brushes; offset_m [2, 6, B], recess_m [6, B]: of the
    contacts, kept from the last step.
    """

    position_m: FloatArray
    velocity_m_s: FloatArray
    stretch_m: FloatArray
    rho: FloatArray
    slip_m_s: FloatArray
    depth_m: FloatArray
    normal_n: FloatArray
    agents_n: FloatArray
    brush_j: FloatArray
    offset_m: FloatArray
    recess_m: FloatArray


def at_rest(body: Body, closure_m: FloatArray) -> State:
    """Nothing moves, nothing is stretched; closure_m [6, B]."""
    elements, contacts, lanes = body.brush_n_per_m.shape
    offset = offset_m(body, np.zeros((2, lanes)))
    state = State(
        np.zeros((3, lanes)),
        np.zeros((3, lanes)),
        np.zeros((2, elements, contacts, lanes)),
        np.ones((elements, contacts, lanes)),
        np.zeros((elements, contacts, lanes)),
        np.zeros((contacts, lanes)),
        np.zeros((contacts, lanes)),
        np.zeros((3, lanes)),
        np.zeros(lanes),
        offset,
        recess_m(body, offset),
    )
    state.depth_m = closure_m - state.recess_m
    return state


def step(
    body: Body,
    state: State,
    inputs: Inputs,
    dt_s: FloatArray,
    t_s: FloatArray,
    effects: PhysicsEffects = NO_EFFECTS,
) -> None:
    """Move every lane by its own dt_s [B], to the time t_s [B]; changes the state in place."""
    old = copy(state)
    load_n, drag = _loads(body, old, inputs, dt_s)
    held_n = load_n + body.mass_kg * body.gravity_m_s2
    for shake in effects.shakes:
        held_n = held_n - body.mass_kg * shake.acceleration_m_s2(t_s)
    speed_x = _normals(body, state, inputs.closure_m, held_n[0], drag[0], dt_s, effects)
    limit_m = _stretch_limit(body, old, state.normal_n, dt_s, effects)
    squeeze_n = (body.curvature_per_m[:, None] * old.offset_m * state.normal_n).sum(axis=1)
    sideways = _sideways(
        body, state, held_n[1:] + squeeze_n, drag[1:] + damping(body, old, limit_m), limit_m, dt_s
    )
    state.velocity_m_s = np.concatenate([speed_x[None], sideways])
    state.position_m = old.position_m + state.velocity_m_s * dt_s
    state.agents_n = load_n - drag * state.velocity_m_s
    given_j = ((held_n - drag * state.velocity_m_s) * (state.velocity_m_s * dt_s)).sum(axis=0)
    if effects.lags:
        given_j = given_j - _taken_by_lags_j(body, old, state, inputs.closure_m, dt_s, effects)
    _keep_the_balance(body, old, state, inputs.closure_m, given_j)
    if effects.lags:
        state.depth_m = inputs.closure_m - state.recess_m - body.side * state.position_m[0]
        change_m = np.maximum(state.depth_m, 0.0) - np.maximum(old.depth_m, 0.0)
        for lag in effects.lags:
            lag.moved(change_m, state.normal_n > 0.0, dt_s)
    for turn in effects.turns:
        turn.turn(body, state, limit_m, dt_s)


def kinetic_j(body: Body, state: State) -> FloatArray:
    """[B] energy of motion."""
    v = state.velocity_m_s
    energy: FloatArray = 0.5 * body.mass_kg * (v[0] * v[0] + v[1] * v[1] + v[2] * v[2])
    return energy


def brush_j(body: Body, state: State) -> FloatArray:
    """[B] energy in the brushes."""
    y, z = state.stretch_m
    squares = y * y
    squares += z * z
    energy: FloatArray = 0.5 * np.einsum("eib,eib->b", body.brush_n_per_m, squares)
    return energy


def normal_j(body: Body, closure_m: FloatArray, x_m: FloatArray, recess: FloatArray) -> FloatArray:
    """[B] energy in the normal springs with the object at x_m [B] and the surface recessed by [6,
    B]."""
    depth = np.maximum(closure_m - recess - body.side * x_m, 0.0)
    energy: FloatArray = 0.5 * (body.stiffness_n_per_m * (depth * depth)).sum(axis=0)
    return energy


def _taken_by_lags_j(
    body: Body,
    old: State,
    state: State,
    closure_m: FloatArray,
    dt_s: FloatArray,
    effects: PhysicsEffects,
) -> FloatArray:
    """[B] what the object's own motion puts into the lags; what the fingers' motion does is not the
    object's to pay."""
    was_m = np.maximum(closure_m - old.recess_m - body.side * old.position_m[0], 0.0)
    recess = recess_m(body, offset_m(body, state.position_m[1:]))
    depth_m = np.maximum(closure_m - recess - body.side * state.position_m[0], 0.0)
    taken_j = np.zeros_like(dt_s)
    for lag in effects.lags:
        stiffness, held_n = lag.terms(dt_s)
        push_n = np.where(
            state.normal_n > 0.0, held_n + stiffness * (depth_m - np.maximum(old.depth_m, 0.0)), 0.0
        )
        taken_j = taken_j + (push_n * (depth_m - was_m)).sum(axis=0)
    return taken_j


def _keep_the_balance(
    body: Body, old: State, state: State, closure_m: FloatArray, given_j: FloatArray
) -> None:
    """Slow a lane that ended with more energy than it had and was given; at a fine step there is
    none.

    Normals and brushes are solved one after the other and the squeeze at the old place, so a long
    step can miss the balance. Where all of its motion is not enough, the object stays where it was.
    """
    state.offset_m = offset_m(body, state.position_m[1:])
    state.recess_m = recess_m(body, state.offset_m)
    had_j = (
        kinetic_j(body, old)
        + old.brush_j
        + normal_j(body, closure_m, old.position_m[0], old.recess_m)
    )
    moving_j, state.brush_j = kinetic_j(body, state), brush_j(body, state)
    still_j = state.brush_j + normal_j(body, closure_m, state.position_m[0], state.recess_m)
    too_much = np.flatnonzero(moving_j + still_j > had_j + given_j)
    if not too_much.size:
        return
    left_j = (had_j + given_j - still_j)[too_much]
    share = np.sqrt(np.maximum(left_j, 0.0) / np.maximum(moving_j[too_much], TINY))
    state.velocity_m_s[:, too_much] *= np.minimum(share, 1.0)
    stuck = too_much[left_j < 0.0]
    if not stuck.size:
        return
    state.position_m[:, stuck] = old.position_m[:, stuck]
    state.stretch_m[..., stuck] = np.minimum(state.rho, 1.0)[..., stuck] * old.stretch_m[..., stuck]
    state.brush_j[stuck] = brush_j(body, state)[stuck]
    state.offset_m[..., stuck], state.recess_m[..., stuck] = (
        old.offset_m[..., stuck],
        old.recess_m[..., stuck],
    )


def offset_m(body: Body, sideways_m: FloatArray) -> FloatArray:
    """[2, 6, B] how far each contact is from where the object is flat, with the object at
    sideways_m [2, B]."""
    from_apex = sideways_m[:, None] - body.at_m
    along = from_apex[1]
    from_apex[1] = along - np.minimum(np.maximum(along, -body.straight_m), body.straight_m)
    return from_apex


def recess_m(body: Body, offset: FloatArray) -> FloatArray:
    """[6, B] how far the surface lies behind its apex at an offset [2, 6, B]."""
    curve = 0.5 * body.curvature_per_m[:, None] * offset
    curve *= offset
    recess: FloatArray = curve[0] + curve[1]
    return recess


def _loads(
    body: Body, state: State, inputs: Inputs, dt_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Forces of people and box at zero velocity [3, B], and what a velocity takes off them [3,
    B]."""
    load_n, drag = np.zeros_like(state.position_m), np.zeros_like(state.position_m)
    for pull in inputs.people:
        to_go = pull.target_m - state.position_m
        ahead = to_go - state.velocity_m_s * dt_s
        reach_m = np.sqrt(ahead[0] * ahead[0] + ahead[1] * ahead[1] + ahead[2] * ahead[2])
        share = np.minimum(1.0, pull.cap_n / np.maximum(pull.stiffness_n_per_m * reach_m, TINY))
        spring, damper = share * pull.stiffness_n_per_m, share * pull.damping_n_s_per_m
        load_n += spring * to_go + damper * pull.target_m_s
        load_n -= pull.weight_share * body.mass_kg * body.gravity_m_s2
        drag += spring * dt_s + damper
    if inputs.floor is not None:
        _add_floor(inputs.floor, state, load_n[2], drag, dt_s)
    return load_n, drag


def _add_floor(
    floor: Floor, state: State, load_n: FloatArray, drag: FloatArray, dt_s: FloatArray
) -> None:
    above_m = floor.height_m - state.position_m[2]
    pressed_m = np.maximum(above_m - state.velocity_m_s[2] * dt_s, 0.0)
    share = np.minimum(1.0, floor.cap_n / np.maximum(floor.stiffness_n_per_m * pressed_m, TINY)) * (
        pressed_m > 0.0
    )
    load_n += share * floor.stiffness_n_per_m * above_m
    drag[2] += share * (floor.stiffness_n_per_m * dt_s + floor.damping_n_s_per_m)
    drag[:2] += share * floor.sideways_n_s_per_m


def _normals(
    body: Body,
    state: State,
    closure_m: FloatArray,
    held_n: FloatArray,
    drag: FloatArray,
    dt_s: FloatArray,
    effects: PhysicsEffects,
) -> FloatArray:
    """Velocity along x [B] at the end of the step; sets depth and normal.

    Which contacts press is found by trying: those that would pull are left out, until none changes.
    """
    side, sideways_m = body.side, state.position_m[1:] + state.velocity_m_s[1:] * dt_s
    stays_m = closure_m - recess_m(body, offset_m(body, sideways_m)) - side * state.position_m[0]
    before_m = np.maximum(state.depth_m, 0.0)
    remembers, memory_n = body.damping_n_s_per_m / dt_s, None
    for lag in effects.lags:
        stiffness, held = lag.terms(dt_s)
        remembers, memory_n = remembers + stiffness, held if memory_n is None else memory_n + held
    slope = body.stiffness_n_per_m + remembers
    still_n = slope * stays_m - remembers * before_m
    if memory_n is not None:
        still_n = still_n + memory_n
    mass, drive = body.mass_kg + dt_s * drag, body.mass_kg * state.velocity_m_s[0] + dt_s * held_n
    speed = state.velocity_m_s[0]
    pressing = None
    for _ in range(MAX_SWEEPS):
        moved_m = side * (speed * dt_s)
        tried = (still_n > slope * moved_m) & (stays_m > moved_m)
        if pressing is not None and np.array_equal(tried, pressing):
            break
        pressing = tried
        push_n = np.where(pressing, side * still_n, 0.0).sum(axis=0)
        speed = (drive + dt_s * push_n) / (
            mass + dt_s * dt_s * np.where(pressing, slope, 0.0).sum(axis=0)
        )
    moved_m = side * (speed * dt_s)
    state.depth_m = stays_m - moved_m
    state.normal_n = np.where(state.depth_m > 0.0, np.maximum(still_n - slope * moved_m, 0.0), 0.0)
    return speed


def damping(body: Body, state: State, limit_m: FloatArray) -> FloatArray:
    """[B] N s/m of the fingers along the surface: of the elements that touch and do not slide."""
    sticks = (state.slip_m_s == 0.0) & (limit_m > 0.0)
    coefficient: FloatArray = body.loss_s * np.where(sticks, body.brush_n_per_m, 0.0).sum(
        axis=(0, 1)
    )
    return coefficient


def _stretch_limit(
    body: Body, state: State, normal_n: FloatArray, dt_s: FloatArray, effects: PhysicsEffects
) -> FloatArray:
    """[E, 6, B] how far friction lets each element stretch."""
    # its speed at first; in place, as is all that is large and often
    friction = state.slip_m_s / body.stribeck_m_s
    friction *= friction
    friction += 1.0
    np.divide(body.static - body.kinetic, friction, out=friction)
    friction += body.kinetic
    for texture in effects.textures:
        friction *= texture.scale(state.slip_m_s * dt_s)
    friction *= body.pressure * normal_n
    friction /= body.brush_n_per_m
    return friction


def _sideways(
    body: Body,
    state: State,
    held_n: FloatArray,
    drag: FloatArray,
    limit_m: FloatArray,
    dt_s: FloatArray,
) -> FloatArray:
    """[2, B] velocity at the end of the step; stretches the brushes by it and lets go what friction
    cannot hold."""
    drive = body.mass_kg * state.velocity_m_s[1:] + dt_s * held_n
    mass = body.mass_kg + dt_s * drag
    velocity, rho, trial, length = _sweep(
        drive, mass, body.brush_n_per_m, state.stretch_m, state.rho, limit_m, dt_s
    )
    change = rho - state.rho
    open_ = two_at_least(
        np.flatnonzero(np.abs(change, out=change).max(axis=(0, 1)) > RHO_TOLERANCE)
    )
    for _ in range(MAX_SWEEPS):
        if not open_.size:
            break
        before = rho[..., open_]
        velocity[:, open_], after, trial[..., open_], length[..., open_] = _sweep(
            drive[:, open_],
            mass[:, open_],
            body.brush_n_per_m[..., open_],
            state.stretch_m[..., open_],
            before,
            limit_m[..., open_],
            dt_s[open_],
        )
        rho[..., open_] = after
        open_ = open_[np.abs(after - before).max(axis=(0, 1)) > RHO_TOLERANCE]
    state.rho = rho
    trial *= rho
    state.stretch_m = trial
    length *= 1.0 - rho
    length /= dt_s
    state.slip_m_s = length
    return velocity


def two_at_least(lanes: IntArray) -> IntArray:
    """A single lane twice: numpy sums one lane in another order than many, and a trial must not
    depend on its batch."""
    return np.repeat(lanes, 2) if len(lanes) == 1 else lanes


def _sweep(
    drive: FloatArray,
    mass: FloatArray,
    brush: FloatArray,
    stretch: FloatArray,
    rho: FloatArray,
    limit: FloatArray,
    dt_s: FloatArray,
) -> tuple[FloatArray, FloatArray, FloatArray, FloatArray]:
    """One reweighting: velocity [2, B] with the springs weakened by rho; rho, stretch and its
    length after it."""
    spring = brush * rho
    stiffness = spring.sum(axis=(0, 1))
    pull = (spring * stretch).sum(axis=(1, 2))
    velocity = (drive - dt_s * pull) / (mass + dt_s * dt_s * stiffness)
    trial = stretch + (velocity * dt_s)[:, None, None]
    length = trial[0] * trial[0]
    length += trial[1] * trial[1]
    np.sqrt(length, out=length)
    held = np.maximum(length, TINY)
    np.divide(limit, held, out=held)
    return velocity, np.minimum(1.0, held, out=held), trial, length
