"""The core of a scene: stable at any step, exact where it sticks, right where there is a closed
form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.simulation.physics.body import (
    Body,
    Floor,
    Inputs,
    Pull,
    State,
    at_rest,
    brush_j,
    kinetic_j,
    normal_j,
    offset_m,
    recess_m,
    sides,
)
from holdfast.simulation.physics.contacts import pressure
from holdfast.simulation.physics.solver import step

G = 9.81
SHARE = np.array([0.5, 0.5, 0.25, 0.25, 0.25, 0.25])[:, None]


def body(
    batch: int = 2,
    *,
    mass_kg: float = 0.2,
    radius_m: float = 0.03,
    ball: bool = False,
    stiffness: float = 600.0,
    friction: float = 0.6,
    kinetic: float = 0.5,
    elements: int = 5,
    gravity: tuple[float, float, float] = (0.0, 0.0, -G),
) -> Body:
    one = np.ones(batch)
    return Body(
        mass_kg=mass_kg * one,
        gravity_m_s2=np.array(gravity)[:, None] * one,
        curvature_per_m=np.array([1 / radius_m, 1 / radius_m if ball else 200.0])[
            :, None
        ]
        * one,
        straight_m=(0.0 if ball else 0.1) * one,
        at_m=np.zeros((2, 6, batch)),
        stiffness_n_per_m=stiffness * np.ones((6, batch)),
        damping_n_s_per_m=1e-3 * stiffness * np.ones((6, batch)),
        brush_n_per_m=stiffness / elements * np.ones((elements, 6, batch)),
        pressure=pressure(elements)[:, None, None],
        static=friction * one,
        kinetic=kinetic * one,
    )


def closed(held: Body, grip_n: float | np.ndarray) -> np.ndarray:
    return np.asarray(SHARE * grip_n / held.stiffness_n_per_m)


def go(
    held: Body, state: State, inputs: Inputs, dt_s: float | np.ndarray, steps: int
) -> None:
    dt = np.broadcast_to(np.asarray(dt_s, float), held.mass_kg.shape)
    for k in range(steps):
        step(held, state, inputs, dt, dt * (k + 1))


def energy_j(held: Body, state: State, closure_m: np.ndarray) -> np.ndarray:
    recess = recess_m(held, offset_m(held, state.position_m[1:]))
    height = -held.mass_kg * (held.gravity_m_s2 * state.position_m).sum(axis=0)
    stored = brush_j(held, state) + normal_j(
        held, closure_m, state.position_m[0], recess
    )
    return np.asarray(kinetic_j(held, state) + stored + height)


def thrown(
    held: Body, closure_m: np.ndarray, rng: np.random.Generator, speed: float
) -> State:
    state = at_rest(held, closure_m)
    batch = held.mass_kg.shape[0]
    state.velocity_m_s = rng.normal(0.0, speed, (3, batch))
    state.position_m[1:] = rng.normal(0.0, 0.003, (2, batch))
    state.offset_m = offset_m(held, state.position_m[1:])
    state.recess_m = recess_m(held, state.offset_m)
    state.depth_m = closure_m - state.recess_m
    return state


AREA = "Simulation"
hard = st.fixed_dictionaries(
    {
        "mass_kg": st.sampled_from([1e-4, 0.0151, 0.5173]),
        "ball": st.booleans(),
        "stiffness": st.sampled_from([50.0, 600.0, 6e6]),
        "friction": st.sampled_from([0.0, 0.6, 1.7]),
        "elements": st.sampled_from([1, 5]),
    }
)
steps_s = st.floats(-6.0, 0.0).map(lambda power: 10.0**power)


any_step = {
    "elsewhere": "a long step throws the object away, a short one drowns in rounding",
    "here": "from a microsecond to a second no step gains energy or leaves the numbers",
}


@pytest.mark.hard_case(AREA, "any step", **any_step)
@settings(max_examples=60)
@given(
    hard,
    steps_s,
    st.sampled_from([0.0, 0.5, 20.0]),
    st.sampled_from([0.0, 0.3, 10.0]),
    st.integers(0, 99),
)
def test_no_step_from_a_microsecond_to_a_second_gains_energy_or_is_not_finite(
    kind, dt_s, grip_n, speed, seed
):
    held = body(16, **{**kind, "kinetic": 0.8 * kind["friction"]})
    rng = np.random.default_rng(seed)
    closure = closed(held, grip_n) * rng.uniform(0.0, 2.0, (6, 16))
    state = thrown(held, closure, rng, speed)
    before = energy_j(held, state, closure)
    scale = np.abs(before) + kinetic_j(held, state) + 1e-9
    for _ in range(25):
        go(held, state, Inputs(closure), dt_s, 1)
        after = energy_j(held, state, closure)
        assert np.isfinite(state.stretch_m).all()
        assert np.isfinite(state.position_m).all()
        height = np.abs(held.mass_kg * G * state.position_m[2])
        assert (after - before <= 1e-9 * (scale + np.abs(before) + height)).all()
        before = after


SHARES = [0.3, 0.5, 0.65]


def held_still(shares: Sequence[float], steps: int) -> tuple[Body, State, np.ndarray]:
    """Each trial held at its share of the friction limit, settled."""
    held = body(len(shares))
    closure = closed(held, 0.2 * G / (2 * 0.6 * np.array(shares)))
    state = at_rest(held, closure)
    go(held, state, Inputs(closure), 1e-3, steps)
    return held, state, closure


holding = {
    "elsewhere": "friction that is a smooth function of velocity creeps, for ever",
    "here": "set-valued friction: nothing moves at all below the limit",
}


@pytest.fixture(scope="module")
def held_long() -> tuple[np.ndarray, State]:
    """Where objects held at SHARES, a trial each, were, and their state 2000 steps later."""
    held, state, closure = held_still(SHARES, 4000)
    before = state.position_m.copy()
    go(held, state, Inputs(closure), 1e-3, 2000)
    return before, state


@pytest.mark.hard_case(AREA, "a million steps of holding", **holding)
@pytest.mark.parametrize("share", SHARES)
def test_a_held_object_does_not_creep(held_long, share):
    before, state = held_long
    place = SHARES.index(share)
    assert np.abs(state.position_m - before)[:, place].max() < 3e-13
    assert not state.slip_m_s[..., place].any()


@pytest.mark.hard_case(AREA, "a million steps of holding", **holding)
@pytest.mark.soak
def test_a_held_object_does_not_creep_in_a_million_steps():
    held, state, closure = held_still([0.65, 0.65], 4000)
    before = state.position_m.copy()
    go(held, state, Inputs(closure), 1e-3, 1_000_000)
    assert np.abs(state.position_m - before).max() < 1e-12


@pytest.mark.hard_case(
    AREA,
    "balance of weight",
    elsewhere="forces are reported that do not add up to what is held",
    here="shear, squeeze and normals of all contacts are the weight",
)
@pytest.mark.parametrize(
    "gravity", [(0.0, 0.0, -G), (3.0, 2.0, -9.0), (G, 0.0, 0.0), (-6.0, -5.0, 4.0)]
)
def test_the_contacts_of_a_held_object_carry_its_weight(gravity):
    held = body(gravity=gravity)
    closure = closed(held, 8.0)
    state = at_rest(held, closure)
    go(held, state, Inputs(closure), 5e-3, 1000)
    shear = (held.brush_n_per_m * state.stretch_m).sum(axis=(1, 2))
    squeeze = (held.curvature_per_m[:, None] * state.offset_m * state.normal_n).sum(
        axis=1
    )
    normal = (sides(6, 2) * state.normal_n).sum(axis=0)
    carried = np.concatenate([-normal[None], shear - squeeze])
    assert carried == pytest.approx(held.mass_kg * held.gravity_m_s2, abs=2e-6)


def pulled(
    held: Body, closure: np.ndarray, force_n: float, steps: int, dt_s: float = 2e-4
) -> State:
    """A constant force along the axis of a cylinder, from rest."""
    gravity = held.gravity_m_s2.copy()
    gravity[2] = force_n / held.mass_kg
    loaded = replace(held, gravity_m_s2=gravity)
    state = at_rest(held, closure)
    go(loaded, state, Inputs(closure), dt_s, steps)
    return state


def test_a_pull_beyond_friction_accelerates_by_what_kinetic_friction_leaves():
    held = replace(body(gravity=(0.0, 0.0, 0.0)), straight_m=np.full(2, 10.0))
    closure = closed(held, 10.0)
    before = pulled(held, closure, 30.0, 800)
    after = pulled(held, closure, 30.0, 900)
    gained = (after.velocity_m_s[2] - before.velocity_m_s[2]) / (100 * 2e-4)
    assert gained == pytest.approx((30.0 - 0.5 * 20.0) / 0.2, rel=0.01)


@pytest.mark.hard_case(
    AREA,
    "a curved object",
    elsewhere="the normal force falls along the path, and the squeeze that belongs to it "
    "is left out",
    here="both are there, and energy is kept",
)
def test_on_a_ball_the_normal_falls_and_squeezes_and_on_a_cylinder_it_does_not():
    moved = np.array([[0.0, 0.0], [0.004, 0.004]])
    for ball in (True, False):
        held = body(ball=ball)
        recess = recess_m(held, offset_m(held, moved))
        assert recess == pytest.approx(
            np.full((6, 2), 0.004**2 / 0.06 if ball else 0.0)
        )
    held = body(ball=True, friction=0.0, kinetic=0.0, gravity=(0.0, 0.0, 0.0))
    closure = closed(held, 10.0)
    state = at_rest(held, closure)
    state.position_m[2] = 0.004
    state.offset_m = offset_m(held, state.position_m[1:])
    state.recess_m = recess_m(held, state.offset_m)
    state.depth_m = closure - state.recess_m
    go(held, state, Inputs(closure), 1e-5, 1)
    normal = (closure - 0.004**2 / 0.06) * 600.0
    assert state.normal_n == pytest.approx(normal, rel=1e-3)
    assert state.velocity_m_s[2] * 0.2 / 1e-5 == pytest.approx(
        (normal * 0.004 / 0.03).sum(axis=0), rel=1e-3
    )


def test_a_pull_is_never_harder_than_its_cap():
    held = body()
    closure = closed(held, 10.0)
    state = at_rest(held, closure)
    zero = np.zeros(2)
    far = np.array([[0.0, 0.0], [0.0, 0.0], [-5.0, -5.0]])
    pull = Pull(zero + 1e3, zero, zero + 4.0, zero, far, far * 0.0)
    go(held, state, Inputs(closure, (pull,)), 5e-3, 600)
    assert state.agents_n[2] == pytest.approx(np.full(2, -4.0), rel=1e-3)
    assert not state.slip_m_s.any()


def slip_time_s(dt_s: float, grips_n: np.ndarray) -> np.ndarray:
    """When the fingers have slipped 1 mm under a load that grows by 150 N/s."""
    held = body(len(grips_n), gravity=(0.0, 0.0, 0.0), kinetic=0.6)
    closure = closed(held, grips_n)
    state = at_rest(held, closure)
    found = np.full(len(grips_n), np.nan)
    travel = np.zeros(len(grips_n))
    for k in range(round(0.25 / dt_s)):
        now = (k + 1) * dt_s
        held.gravity_m_s2[2] = 150.0 * now / held.mass_kg
        go(held, state, Inputs(closure), dt_s, 1)
        slipped = state.slip_m_s.mean(axis=(0, 1)) * dt_s
        crosses = np.isnan(found) & (travel + slipped >= 1e-3)
        found = np.where(
            crosses,
            now - dt_s * (travel + slipped - 1e-3) / np.maximum(slipped, 1e-12),
            found,
        )
        travel = travel + slipped
    assert np.isfinite(found).all()
    return found


@pytest.mark.hard_case(
    AREA,
    "accuracy of the step",
    elsewhere="a step is called fine because nothing explodes",
    here="the error of the slip time is known: of first order in the step",
)
def test_slip_time_is_first_order_in_the_step():
    grips_n = np.random.default_rng(0).uniform(5.0, 12.0, 20)
    reference = slip_time_s(2e-4, grips_n)
    steps = np.array([2e-3, 1e-3, 5e-4])
    errors = [
        np.median(np.abs(slip_time_s(dt_s, grips_n) - reference)) for dt_s in steps
    ]
    order = np.polyfit(np.log(steps), np.log(errors), 1)[0]
    assert 0.6 < order < 1.4
    assert errors[1] < 1e-3


angles = st.floats(-np.pi, np.pi)
directions = st.tuples(st.floats(-1.0, 1.0), angles)


def unit(direction: tuple[float, float]) -> np.ndarray:
    """A unit vector of its share along the thumb's axis and its angle about it."""
    along, angle = direction
    across = np.sqrt(1.0 - along * along)
    return np.array([along, across * np.cos(angle), across * np.sin(angle)])


@settings(max_examples=25)
@given(angles, directions, directions, st.integers(0, 99))
def test_a_world_turned_about_the_thumbs_axis_turns_the_forces(angle, down, pull, seed):
    cos, sin = np.cos(angle), np.sin(angle)
    turn = np.array([[1.0, 0.0, 0.0], [0.0, cos, -sin], [0.0, sin, cos]])
    places = 1e-3 * np.random.default_rng(seed).normal(size=(2, 6, 1))

    def after(turned: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        one = np.ones(2)
        held = replace(
            body(ball=True, friction=0.7, gravity=tuple(turned @ (G * unit(down)))),
            at_m=np.einsum("ij,jsb->isb", turned[1:, 1:], places) * one,
        )
        closure = closed(held, 4.0)
        person = Pull(
            stiffness_n_per_m=800.0 * one,
            damping_n_s_per_m=15.0 * one,
            cap_n=6.0 * one,
            weight_share=0.3 * one,
            target_m=(turned @ (0.05 * unit(pull)))[:, None] * one,
            target_m_s=np.zeros((3, 2)),
        )
        state = at_rest(held, closure)
        go(held, state, Inputs(closure, (person,)), 1e-3, 120)
        shear = (held.brush_n_per_m * state.stretch_m).sum(axis=1)
        return state.position_m[:, 0], shear[..., 0], state.normal_n[:, 0]

    place, shear, normal = after(np.eye(3))
    turned_place, turned_shear, turned_normal = after(turn)
    assert turned_place == pytest.approx(turn @ place, abs=1e-6)
    assert turned_shear == pytest.approx(turn[1:, 1:] @ shear, abs=1e-3)
    assert turned_normal == pytest.approx(normal, abs=1e-3)


@settings(max_examples=25)
@given(directions, steps_s)
def test_a_box_on_any_side_returns_no_more_than_fell_on_it(up, dt_s):
    one = np.ones(2)
    held = body(gravity=(0.0, 0.0, 0.0))
    far = np.full((6, 2), -1.0)
    state = at_rest(held, far)
    away = unit(up)[:, None] * one
    state.velocity_m_s = -0.4 * away
    floor = Floor(4e3, 40.0, 300.0, -1e-4 * one, 50.0 * one, away)
    moving_j = kinetic_j(held, state)
    for _ in range(60):
        go(held, state, Inputs(far, (), floor), dt_s, 1)
        assert (kinetic_j(held, state) <= moving_j + 1e-12).all()
        assert np.isfinite(state.position_m).all()
