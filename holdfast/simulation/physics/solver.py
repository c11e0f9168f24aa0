"""The solver: brush contacts on an object in 3D, one implicit step, many trials at once.

body.py has the frame, the arrays and what they mean; every trial has a step length of its own.
Contact i presses by how deep its finger is closed into the object:

    depth_i = closure_i(t) - s_i x - r_i,   s = +1 thumb, -1 finger
    r_i = (curvature_y dy^2 + curvature_z dz^2) / 2
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

At the end of a step the energy is balanced: no trial ends with more than it had and was given.
"""

from __future__ import annotations

from collections.abc import Callable

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, IntArray
from holdfast.simulation.effects.effect import NO_EFFECTS, PhysicsEffects
from holdfast.simulation.physics.body import (
    TINY,
    Body,
    Floor,
    Inputs,
    State,
    add,
    changed,
    keep_the_balance,
    offset_m,
    recess_m,
    taken_by_lags_j,
)

Swept = tuple[FloatArray, FloatArray, FloatArray, FloatArray]
"""What a sweep of the brushes gives: speed, rho, trial stretch, length of the trial stretch."""
RHO_TOLERANCE = 2e-3
"""Reweighting ends where no rho changes by more than this."""
MAX_SWEEPS = 60
"""A bound only: almost every step settles in one or two sweeps."""


def step(
    body: Body,
    state: State,
    inputs: Inputs,
    dt_s: FloatArray,
    t_s: FloatArray,
    effects: PhysicsEffects = NO_EFFECTS,
) -> None:
    """Move every trial by its own dt_s [B], to the time t_s [B]; changes the state in place."""
    # The step reads the old arrays while it writes new ones into `state`.
    old = State(**vars(state))
    body, more_n, added_n = changed(body, inputs.changes)
    closure_m = inputs.closure_m
    for unsteady in effects.grips:
        closure_m = unsteady.closure_m(closure_m, t_s)

    # Forces that do not depend on the contacts: people, box, weight, and the hand's acceleration,
    # which acts on the object as an inertial force because the frame moves with the hand.
    load_n, drag = _loads(body, old, inputs, dt_s)
    if more_n is not None:
        load_n += more_n
    weight_n = body.mass_kg * body.gravity_m_s2
    held_n = load_n + weight_n
    shaken_n = np.zeros_like(held_n)
    for shake in effects.shakes:
        inertial_n = body.mass_kg * shake.acceleration_m_s2(t_s)
        held_n = held_n - inertial_n
        shaken_n = shaken_n - inertial_n

    # Normals first, because they decide how much friction the brushes may use.
    speed_x = _normals(body, state, closure_m, held_n[0], drag[0], dt_s, effects)
    limit_m = _stretch_limit(body, old, state.normal_n, dt_s, effects)

    # A curved surface leans, so the normal force has a part along the skin.
    slope = body.curvature_per_m[:, None] * old.offset_m
    leaning_n = slope * state.normal_n
    along_n = held_n[1:] + add(leaning_n, axis=1)

    # Fingers damp only what sticks to them.
    along_drag = drag[1:] + damping(body, old, limit_m)
    speed_yz = _sideways(body, state, along_n, along_drag, limit_m, dt_s)
    state.velocity_m_s = np.concatenate([speed_x[None], speed_yz])

    moved_m = state.velocity_m_s * dt_s
    state.position_m = old.position_m + moved_m

    # What people and box really exert is known only now, at the new velocity.
    resisted_n = drag * state.velocity_m_s
    state.agents_n = load_n - resisted_n
    if added_n is not None:
        state.agents_n += added_n

    # Work of weight, people, box and shakes on the way of this step.
    net_n = held_n - resisted_n
    given_j = add(net_n * moved_m, axis=0)
    if effects.lags:
        taken_j = taken_by_lags_j(body, old, state, closure_m, dt_s, effects)
        given_j = given_j - taken_j
    keep_the_balance(body, old, state, closure_m, given_j)

    # Memory and rotation follow the balanced motion, not the one that was tried.
    if effects.lags:
        _move_lags(body, old, state, closure_m, dt_s, effects)
    for turn in effects.turns:
        turn.turn(body, state, limit_m, dt_s, shaken_n)


def _move_lags(
    body: Body,
    old: State,
    state: State,
    closure_m: FloatArray,
    dt_s: FloatArray,
    effects: PhysicsEffects,
) -> None:
    """Let the lags take in the change of depth of a step."""
    place_m = body.side * state.position_m[0]
    state.depth_m = closure_m - state.recess_m - place_m

    # Silicone remembers only what was pressed in: a gap changes nothing.
    pressed_m = np.maximum(state.depth_m, 0.0)
    pressed_before_m = np.maximum(old.depth_m, 0.0)
    change_m = pressed_m - pressed_before_m

    touching = state.normal_n > 0.0
    for lag in effects.lags:
        lag.follow(change_m, touching, dt_s)


def _loads(
    body: Body, state: State, inputs: Inputs, dt_s: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """(forces of people and box at zero velocity, what a velocity takes off them), [3, B] each."""
    load_n = np.zeros_like(state.position_m)
    drag = np.zeros_like(state.position_m)
    moved_m = state.velocity_m_s * dt_s

    for pull in inputs.people:
        to_go_m = pull.target_m - state.position_m

        # The cap is judged where the object will be if it keeps its speed.
        squares = to_go_m - moved_m
        squares *= squares
        distance_m = np.sqrt(squares[0] + squares[1] + squares[2])
        reach_n = pull.stiffness_n_per_m * distance_m
        share = np.minimum(1.0, pull.cap_n / np.maximum(reach_n, TINY))

        # A capped arm is a softer arm: spring and damper shrink together.
        spring = share * pull.stiffness_n_per_m
        damper = share * pull.damping_n_s_per_m

        # The damper acts on the speed relative to the target: the part of the target is a load
        # here, the part of the object is in the drag below.
        load_n += spring * to_go_m + damper * pull.target_m_s
        # A borne share of the weight acts against gravity.
        load_n -= pull.weight_share * body.mass_kg * body.gravity_m_s2

        # Implicit: the spring at the end of the step has followed the object by v dt.
        drag += spring * dt_s + damper

    if inputs.floor is not None:
        _add_floor(inputs.floor, state, load_n, drag, dt_s)

    return load_n, drag


def _add_floor(
    floor: Floor, state: State, load_n: FloatArray, drag: FloatArray, dt_s: FloatArray
) -> None:
    """Add the box to the forces load_n [3, B], and to the drag [3, B], in place."""
    place_m = add(floor.up * state.position_m, axis=0)
    speed_m_s = add(floor.up * state.velocity_m_s, axis=0)
    above_m = floor.height_m - place_m

    # As for people, the cap is judged at the end of a step with the old speed.
    sunk_m = above_m - speed_m_s * dt_s
    pressed_m = np.maximum(sunk_m, 0.0)
    pressed_n = floor.stiffness_n_per_m * pressed_m
    capped = np.minimum(1.0, floor.cap_n / np.maximum(pressed_n, TINY))
    share = capped * (pressed_m > 0.0)

    # The spring is implicit, as those of people: what it loses to the way of this step is drag.
    push_n = share * floor.stiffness_n_per_m * above_m
    follows = floor.stiffness_n_per_m * dt_s
    upwards = share * (follows + floor.damping_n_s_per_m)
    sideways = share * floor.sideways_n_s_per_m
    # A drag has one number an axis. These bound the push's own, n n' (Gershgorin), so no step
    # gains energy; along an axis they are exact.
    size = np.abs(floor.up)
    along = size * add(size, axis=0)
    load_n += push_n * floor.up
    drag += upwards * along + sideways * (1.0 - size * size)


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

    Trial and error decides which contacts press: those that would pull drop out until none changes.
    """
    side = body.side

    # The surface under a contact, where the object will be if it keeps its speed sideways.
    sideways_m = state.position_m[1:] + state.velocity_m_s[1:] * dt_s
    recessed_m = recess_m(body, offset_m(body, sideways_m))

    # Depth at the end of the step if the object stayed where it is.
    stays_m = closure_m - recessed_m - side * state.position_m[0]

    remembers, memory_n = _memory(body, effects, dt_s)
    # N = still_n - slope * (how far the object moves away in this step)
    slope = body.stiffness_n_per_m + remembers
    pressed_before_m = np.maximum(state.depth_m, 0.0)
    still_n = slope * stays_m - remembers * pressed_before_m
    if memory_n is not None:
        still_n = still_n + memory_n

    # Backward Euler for m dv/dt = held - drag v + sum of side N, multiplied by dt.
    speed = state.velocity_m_s[0]
    mass = body.mass_kg + dt_s * drag
    drive = body.mass_kg * speed + dt_s * held_n

    # Both are the same in every sweep.
    pushed_n = side * still_n
    square_s2 = dt_s * dt_s
    pressing = None
    for _ in range(MAX_SWEEPS):
        # A contact presses where its force is positive and it touches.
        moved_m = side * (speed * dt_s)
        pushes = still_n > slope * moved_m
        touches = stays_m > moved_m
        tried = pushes & touches
        if pressing is not None and (tried == pressing).all():
            break

        pressing = tried
        push_n = add(np.where(pressing, pushed_n, 0.0), axis=0)
        stiff = add(np.where(pressing, slope, 0.0), axis=0)
        speed = (drive + dt_s * push_n) / (mass + square_s2 * stiff)

    moved_m = side * (speed * dt_s)
    state.depth_m = stays_m - moved_m
    pressed_n = np.maximum(still_n - slope * moved_m, 0.0)

    # A damper alone could still push a little after contact has ended.
    state.normal_n = np.where(state.depth_m > 0.0, pressed_n, 0.0)
    return speed


def _memory(
    body: Body, effects: PhysicsEffects, dt_s: FloatArray
) -> tuple[FloatArray, FloatArray | None]:
    """Of the forces that remember the depth before the step: stiffness N/m, and force N.

    They are the damper's and those of the effects' lags. The force is None without a lag, so that a
    scene without lags adds nothing.
    """
    # A damper, c d(depth)/dt, is implicitly c / dt times the change of depth: a spring whose rest
    # is the old depth.
    remembers = body.damping_n_s_per_m / dt_s
    memory_n: FloatArray | None = None
    for lag in effects.lags:
        stiffness, held = lag.terms(dt_s)
        remembers = remembers + stiffness
        memory_n = held if memory_n is None else memory_n + held
    return remembers, memory_n


def damping(body: Body, state: State, limit_m: FloatArray) -> FloatArray:
    """[B] damping of the fingers along the surface, N s/m: of the elements that stick."""
    # Exactly zero: the return mapping writes zero where friction holds.
    holds = state.slip_m_s == 0.0
    touches = limit_m > 0.0
    stuck = np.where(holds & touches, body.brush_n_per_m, 0.0)
    return body.loss_s * add(stuck, axis=(0, 1))


def _stretch_limit(
    body: Body,
    state: State,
    normal_n: FloatArray,
    dt_s: FloatArray,
    effects: PhysicsEffects,
) -> FloatArray:
    """[E, S, B] how far friction lets each element stretch, m.

    mu(v) = kinetic + (static - kinetic) / (1 + (v / v_s)^2), v the slip speed (Stribeck); the limit
    is mu(v) * pressure * N / k_e.
    """
    # In place, because this array is large and computed every step: it holds the slip speed first,
    # then the friction coefficient, then the force, at last the stretch.
    limit = state.slip_m_s / body.stribeck_m_s
    limit *= limit
    limit += 1.0
    np.divide(body.static - body.kinetic, limit, out=limit)
    limit += body.kinetic

    # A rough surface swings the coefficient as the element travels over it.
    for texture in effects.textures:
        limit *= texture.scale(state.slip_m_s * dt_s)

    # Without contact the normal force is zero, and so is the stretch that friction holds.
    limit *= body.pressure * normal_n
    limit /= body.brush_n_per_m
    return limit


def _sideways(
    body: Body,
    state: State,
    held_n: FloatArray,
    drag: FloatArray,
    limit_m: FloatArray,
    dt_s: FloatArray,
) -> FloatArray:
    """[2, B] velocity at the end of the step; stretches the brushes as far as friction holds."""
    # Backward Euler as along x; the springs of the brushes come in with every sweep.
    drive = body.mass_kg * state.velocity_m_s[1:] + dt_s * held_n
    mass = body.mass_kg + dt_s * drag
    brushes = (drive, mass, body.brush_n_per_m, state.stretch_m, limit_m, dt_s)
    velocity, state.rho, trial, length = settle(_sweep, state.rho, brushes)

    # The return mapping: of the trial stretch, rho is held ..
    trial *= state.rho
    state.stretch_m = trial

    # .. and the rest has slipped. In place, because these arrays are large.
    slipped = length
    slipped *= 1.0 - state.rho
    slipped /= dt_s
    state.slip_m_s = slipped

    return velocity


def settle(
    sweep: Callable[..., Swept], rho: FloatArray, parts: tuple[FloatArray, ...]
) -> Swept:
    """Reweight the springs of the brushes until no rho changes any more.

    sweep: (rho, *parts) -> (speed, rho, trial stretch, its length), each [.., B].
    """
    # The last rho is a good guess: most trials settle in the first sweep, which all take.
    swept = sweep(rho, *parts)
    moving = _unsettled(rho, swept[1])
    unsettled = two_at_least(moving.nonzero()[0])

    for _ in range(MAX_SWEEPS):
        if not unsettled.size:
            break

        # Only the trials whose rho still moves are swept again.
        before = swept[1][..., unsettled]
        # These are copies, so what the sweep gives is written back below.
        some_parts = [part[..., unsettled] for part in parts]
        again = sweep(before, *some_parts)
        for whole, some in zip(swept, again, strict=True):
            whole[..., unsettled] = some

        still_moving = _unsettled(before, again[1])
        unsettled = unsettled[still_moving]

    return swept


def _unsettled(before: FloatArray, rho: FloatArray) -> BoolArray:
    """[B] whether any rho [E, S, B] still changes."""
    change = rho - before
    np.abs(change, out=change)
    largest = np.maximum.reduce(change, axis=(0, 1))
    return largest > RHO_TOLERANCE


def two_at_least(trials: IntArray) -> IntArray:
    """The trials; a single one twice.

    numpy sums one trial in another order than many, and a trial must not depend on its batch.
    """
    return np.repeat(trials, 2) if len(trials) == 1 else trials


def _sweep(
    rho: FloatArray,
    drive: FloatArray,
    mass: FloatArray,
    brush: FloatArray,
    stretch: FloatArray,
    limit: FloatArray,
    dt_s: FloatArray,
) -> Swept:
    """One reweighting of the springs by rho: (velocity [2, B], rho, stretch, its length).

    A brush that slips pulls with rho times its spring, so the velocity has a closed form.
    """
    spring = brush * rho
    stiffness = add(spring, axis=(0, 1))
    pull = add(spring * stretch, axis=(1, 2))

    # At the end of the step a stretch has grown by v dt, so a spring adds k dt^2 to the mass.
    velocity = (drive - dt_s * pull) / (mass + dt_s * dt_s * stiffness)

    # Every element moves with the object.
    moved = velocity * dt_s
    trial = stretch + moved[:, None, None]
    length = trial[0] * trial[0]
    length += trial[1] * trial[1]
    np.sqrt(length, out=length)

    # rho: the share of the trial stretch that friction can hold.
    held = np.maximum(length, TINY)
    np.divide(limit, held, out=held)
    np.minimum(1.0, held, out=held)
    return velocity, held, trial, length
