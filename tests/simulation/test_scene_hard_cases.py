"""The core of a scene where simulators break: at the cone's edge, without mass, friction or force,
stiff, hit."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from test_scene_physics import G, at_rest, body, closed, energy_j, go

from holdfast.core.errors import CardError
from holdfast.simulation.physics.body import Body, Floor, Inputs, State, brush_j
from holdfast.simulation.scenes.scene_file import read_scene_file

AREA = "Simulation"
EVERY_STEP = pytest.mark.parametrize("dt_s", [1e-6, 1e-3, 1.0])


def at_the_edge(load_n: float) -> tuple[Body, State, np.ndarray]:
    """Six contacts stretched to their limits, 8 N together, and a load along the axis; powers of
    two throughout."""
    held = body(
        2,
        mass_kg=0.25,
        stiffness=512.0,
        friction=0.5,
        kinetic=0.25,
        elements=1,
        gravity=(0.0, 0.0, load_n / 0.25),
    )
    closure = closed(held, 8.0)
    state = at_rest(held, closure)
    state.normal_n = held.stiffness_n_per_m * closure
    state.stretch_m[1] = 0.5 * state.normal_n / held.brush_n_per_m
    state.brush_j = brush_j(held, state)
    return held, state, closure


@pytest.mark.hard_case(
    AREA,
    "stick exactly at the cone's edge",
    elsewhere="rounding decides whether it slips, and another step decides otherwise",
    here="at the limit it sticks, at any step and but for the last bit; a thousandth more slips",
)
@EVERY_STEP
def test_at_the_limit_nothing_moves_below_it_nothing_slips_and_beyond_it_slides(dt_s):
    moved_m, slipped_m = after(8.0, dt_s)
    assert max(moved_m, slipped_m) < 1e-14
    assert after(7.992, dt_s)[1] == 0.0
    assert min(after(8.008, dt_s)) > 1e-7


def after(load_n: float, dt_s: float) -> tuple[float, float]:
    """How far the object has moved and slipped after 200 steps under this load, m."""
    held, state, closure = at_the_edge(load_n)
    slipped_m = 0.0
    for _ in range(200):
        go(held, state, Inputs(closure), dt_s, 1)
        slipped_m += float(state.slip_m_s.mean()) * dt_s
    return float(np.abs(state.position_m).max()), slipped_m


@pytest.mark.hard_case(
    AREA,
    "zero friction",
    elsewhere="the ratio of shear to limit is zero divided by zero",
    here="nothing holds, nothing shears: it falls freely between the fingers",
)
@EVERY_STEP
def test_without_friction_it_falls_freely_between_pressing_fingers(dt_s):
    held = replace(body(friction=0.0, kinetic=0.0), straight_m=np.full(2, 1e9))
    closure = closed(held, 8.0)
    state = at_rest(held, closure)
    go(held, state, Inputs(closure), dt_s, 50)
    assert state.velocity_m_s[2] == pytest.approx(np.full(2, -G * 50 * dt_s))
    assert not state.stretch_m.any()
    assert state.normal_n.sum() == pytest.approx(2 * 16.0)


@pytest.mark.hard_case(
    AREA,
    "zero normal force",
    elsewhere="the direction of a force of no length is not a number",
    here="a finger that only touches carries nothing",
)
@EVERY_STEP
def test_fingers_that_only_touch_carry_nothing(dt_s):
    held = replace(body(), straight_m=np.full(2, 1e9))
    closure = np.zeros((6, 2))
    state = at_rest(held, closure)
    go(held, state, Inputs(closure), dt_s, 50)
    assert not state.normal_n.any()
    assert not state.stretch_m.any()
    assert state.velocity_m_s[2] == pytest.approx(np.full(2, -G * 50 * dt_s))
    floating = replace(
        held, gravity_m_s2=np.zeros((3, 2))
    )  # no force, no limit, no way
    state = at_rest(floating, closure)
    go(floating, state, Inputs(closure), dt_s, 50)
    assert not state.velocity_m_s.any()
    assert not state.stretch_m.any()


@pytest.mark.hard_case(
    AREA,
    "friction above one",
    elsewhere="a pyramid or a clipped coefficient lets go at one",
    here="silicone at 1.7 holds more weight than it is pressed with",
)
@pytest.mark.parametrize(("share", "holds"), [(0.9, True), (1.1, False)])
def test_silicone_that_sticks_by_more_than_it_is_pressed(share, holds):
    held = body(friction=1.7, kinetic=1.5)
    closure = closed(held, 0.2 * G / (2 * 1.7 * share))
    state = at_rest(held, closure)
    state.stretch_m[1] = (
        -1.7
        * share
        * held.pressure
        * held.stiffness_n_per_m
        * closure
        / held.brush_n_per_m
        * (1.0 if holds else 0.0)
    )
    state.brush_j = brush_j(held, state)
    go(held, state, Inputs(closure), 1e-3, 1500)
    pressed_n = state.normal_n.sum(axis=0)
    assert (pressed_n < 0.2 * G).all()
    assert (np.abs(state.velocity_m_s[2]) < 1e-6).all() == holds


@pytest.mark.hard_case(
    AREA,
    "zero mass",
    elsewhere="a force on no mass gives an infinite acceleration",
    here="a card takes no object under a tenth of a gram, and the core is stable at that",
)
def test_an_object_without_mass_is_refused_and_a_tenth_of_a_gram_is_held(
    tmp_path: Path,
):
    text = '[objects.air]\nmass_g = 0\n[[trials]]\nobjects = ["air"]\naction = "pull"\n'
    (tmp_path / "mine.toml").write_text(text)
    with pytest.raises(
        CardError, match=r"mass_g = 0; next: allowed: a number from 0\.1"
    ):
        read_scene_file(str(tmp_path / "mine.toml"))
    held = body(mass_kg=1e-4)
    closure = closed(held, 1.0)
    state = at_rest(held, closure)
    go(held, state, Inputs(closure), 5e-3, 400)
    assert np.abs(state.velocity_m_s).max() < 1e-9


@pytest.mark.hard_case(
    AREA,
    "517 g on one finger",
    elsewhere="the load of an overdetermined grip is spread by least squares, for ever",
    here="thumb and index alone carry the full bottle, and let go where they cannot",
)
@pytest.mark.parametrize(("share", "holds"), [(0.8, True), (1.3, False)])
def test_the_full_bottle_hangs_on_one_finger_and_the_thumb(share, holds):
    held = replace(body(mass_kg=0.5173, stiffness=2000.0), straight_m=np.full(2, 0.2))
    grip_n = 0.5173 * G / (2 * 0.6 * share)
    alone = np.array([0.5, 0.5, 1.0, 0.0, 0.0, 0.0])[:, None]
    grown = np.zeros((6, 2))
    state = at_rest(held, grown)
    support = Floor(4e3, 40.0, 300.0, np.zeros(2), np.full(2, 50.0))
    for part in np.linspace(
        0.0, 1.0, 500
    ):  # closed on, and then the support is lowered
        grown = alone * part * grip_n / held.stiffness_n_per_m
        go(held, state, Inputs(grown, (), support), 2e-3, 1)
    for below in np.linspace(0.0, 0.02, 1000):
        go(
            held,
            state,
            Inputs(grown, (), replace(support, height_m=np.full(2, -below))),
            2e-3,
            1,
        )
    go(held, state, Inputs(grown), 2e-3, 1000)
    shear_n = (held.brush_n_per_m * state.stretch_m[1]).sum(axis=0)
    assert (np.abs(state.velocity_m_s[2]) < 1e-6).all() == holds
    assert not state.normal_n[3:].any()
    if holds:
        assert shear_n.sum(axis=0) == pytest.approx(np.full(2, -0.5173 * G), rel=1e-5)


# -- stiff contacts, hard impacts


@pytest.mark.hard_case(
    AREA,
    "a contact ten thousand times stiffer",
    elsewhere="an explicit step is stable only below 2 sqrt(m / k)",
    here="one implicit step, stable at any; it holds what the soft contact holds",
)
@EVERY_STEP
@pytest.mark.parametrize("stiffness", [600.0, 6e6])
def test_a_stiff_contact_holds_and_neither_rings_nor_gains_energy(stiffness, dt_s):
    held = body(8, stiffness=stiffness)
    closure = closed(held, 8.0)
    state = at_rest(held, closure)
    state.velocity_m_s = np.random.default_rng(3).normal(0.0, 0.02, (3, 8))
    most = 0.0
    before = energy_j(held, state, closure)
    for _ in range(300):
        go(held, state, Inputs(closure), dt_s, 1)
        after = energy_j(held, state, closure)
        most = max(most, float((after - before).max()))
        before = after
    assert most < 1e-12
    assert np.isfinite(state.position_m).all()
    if dt_s == 1e-3:
        assert np.abs(state.velocity_m_s).max() < 1e-3


def fallen_on(
    box: Floor, speed_m_s: float, dt_s: float, mass_kg: float, steps: int
) -> list[tuple[float, float]]:
    """(momentum gained, momentum given) in each step, kg m/s; fingers away, from 1 cm above the
    box."""
    held = body(mass_kg=mass_kg)
    state = at_rest(held, np.full((6, 2), -1.0))
    state.velocity_m_s[2] = -speed_m_s
    balance = []
    for _ in range(steps):
        before = state.velocity_m_s[2].copy()
        go(held, state, Inputs(np.full((6, 2), -1.0), (), box), dt_s, 1)
        given = (state.agents_n[2] - mass_kg * G) * dt_s
        balance.append(
            (float(mass_kg * (state.velocity_m_s[2] - before)[0]), float(given[0]))
        )
        assert (
            abs(state.velocity_m_s[2, 0]) <= speed_m_s + G * dt_s * len(balance) + 1e-9
        )
    return balance


@pytest.mark.hard_case(
    AREA,
    "an impact at high speed",
    elsewhere="a deep first step, and the spring throws it back faster than it came",
    here="never faster than it came, and momentum is what box and weight have given, in every step",
)
@settings(max_examples=40)
@given(
    st.floats(0.1, 30.0),
    st.floats(-6.0, 0.0).map(lambda power: 10.0**power),
    st.sampled_from([0.0151, 0.5173]),
)
def test_an_object_thrown_at_a_box_obeys_the_balance_of_momentum(
    speed_m_s, dt_s, mass_kg
):
    box = Floor(4e3, 40.0, 300.0, np.full(2, -0.01), np.full(2, 1e6))
    for gained, given_ in fallen_on(box, speed_m_s, dt_s, mass_kg, 60):
        assert gained == pytest.approx(
            given_, rel=1e-6, abs=1e-9 * mass_kg * (1.0 + speed_m_s)
        )
