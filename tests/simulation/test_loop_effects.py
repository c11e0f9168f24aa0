"""Effects of the loop: each obeys its law, none makes energy, and a trial is the same in any
batch."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from holdfast.core.contract import FloatArray
from holdfast.simulation.effects import shakes
from holdfast.simulation.effects.effect import EffectBatch, PhysicsEffects, stream
from holdfast.simulation.physics import contacts
from holdfast.simulation.physics.body import (
    Body,
    Inputs,
    Pull,
    State,
    at_rest,
    kinetic_j,
    normal_j,
)
from holdfast.simulation.physics.contacts import Lag, Rotation, gyration_m2, pressure
from holdfast.simulation.physics.objects import OBJECTS
from holdfast.simulation.physics.solver import step

EFFECTS = contacts.EFFECTS | shakes.EFFECTS
FINGERS = np.array([1000.0, 1000.0, 500.0, 500.0, 500.0, 500.0])
"""N/m: two stiff of the thumb against four, so that equal depths balance."""
DEPTH_M = 5e-3
ALONG = np.array([[0.0] * 6, [12e-3, -12e-3, 33e-3, 11e-3, -11e-3, -33e-3]])


def make(
    name: str,
    batch: int = 2,
    thing: str = "basket-ball",
    numbers: Any = None,
    **options: Any,
) -> Any:
    """An effect for a batch; options: one value, or one for every trial."""
    numbers = range(batch) if numbers is None else numbers
    trials = [
        SimpleNamespace(finger_n_per_m=FINGERS, object=OBJECTS[thing]) for _ in numbers
    ]
    effect = EFFECTS[name]
    rngs = [stream(7, number, name) for number in numbers]
    drawn = [
        effect.draw(options, stream(7, number, f"{name} parameters"))
        for number in numbers
    ]
    return effect.make(EffectBatch(drawn, trials, rngs))


def body(
    batch: int = 2,
    elements: int = 1,
    mass_kg: float = 0.1,
    friction: float = 0.6,
    gravity_m_s2: float = 9.81,
    at_m: FloatArray = ALONG,
    per_m: float = 0.0,
    brush_n_per_m: float = 1.0,
    damping_s: float = 0.0,
    loss_s: float = 2e-3,
) -> Body:
    """Six fingers on something; per_m: its curvature, brush_n_per_m: over a finger's normal
    stiffness."""
    stiffness = np.repeat(FINGERS[:, None], batch, axis=1)
    return Body(
        mass_kg=np.full(batch, mass_kg),
        gravity_m_s2=np.outer([0.0, 0.0, -gravity_m_s2], np.ones(batch)),
        curvature_per_m=np.full((2, batch), per_m),
        straight_m=np.zeros(batch),
        at_m=np.repeat(at_m[..., None], batch, axis=2),
        stiffness_n_per_m=stiffness,
        damping_n_s_per_m=damping_s * stiffness,
        brush_n_per_m=np.repeat(
            brush_n_per_m * stiffness[None] / elements, elements, axis=0
        ),
        pressure=pressure(elements)[:, None, None],
        static=np.full(batch, friction),
        kinetic=np.full(batch, friction),
        loss_s=loss_s,
    )


def shut(batch: int = 2, depth_m: float = DEPTH_M) -> FloatArray:
    return np.full((6, batch), depth_m)


def run(
    what: Body,
    dt_s: float,
    steps: int,
    effects: PhysicsEffects,
    inputs: Callable[[float], Inputs] | None = None,
    watch: Callable[[State], Any] = lambda state: None,
    state: State | None = None,
) -> tuple[State, FloatArray]:
    """Step from rest (or a state) with shut fingers (or inputs of the time); what watch saw after
    every step."""
    batch = len(what.mass_kg)
    state = at_rest(what, shut(batch)) if state is None else state
    held = Inputs(shut(batch))
    seen = []
    for k in range(1, steps + 1):
        now = held if inputs is None else inputs(k * dt_s)
        step(what, state, now, np.full(batch, dt_s), np.full(batch, k * dt_s), effects)
        seen.append(watch(state))
    return state, np.array(seen)


def carry(
    batch: int = 2,
    speed_m_s: float = 0.0,
    t_s: float = 0.0,
    stiff: float = 1e5,
    share: float = 0.0,
) -> Pull:
    """A person strong enough to lead the object along y."""
    to = np.outer([0.0, speed_m_s, 0.0], np.ones(batch))
    one = np.ones(batch)
    return Pull(stiff * one, 1e-2 * stiff * one, 1e6 * one, share * one, to * t_s, to)


# brush


@pytest.mark.parametrize("count", [1, 2, 5, 50])
def test_the_shares_of_a_brush_are_a_parabola_that_bears_everything(count: int) -> None:
    share = pressure(count)
    assert share.sum() == pytest.approx(1.0, abs=1e-12)
    assert (np.diff(share) < 0.0).all()
    assert np.ptp(np.diff(share, 2)) < 1e-12 if count > 2 else True
    assert (share > 0.0).all()


def test_slip_begins_at_the_rim_of_a_brush_and_ends_in_its_middle() -> None:
    what = body(elements=5, gravity_m_s2=0.0)
    _, slides = run(
        what,
        5e-4,
        1500,
        PhysicsEffects(),
        inputs=lambda t: Inputs(shut(), (carry(speed_m_s=0.01, t_s=t),)),
        watch=lambda state: state.slip_m_s[:, 0, 0] > 5e-3,
    )
    first = slides.argmax(axis=0)
    assert slides.any(axis=0).all()
    assert (np.diff(first) < 0).all()


# texture


@pytest.mark.parametrize(
    ("speed_m_s", "wavelength_mm"), [(0.02, 1.0), (0.04, 1.0), (0.01, 0.5)]
)
def test_a_slide_over_texture_vibrates_with_speed_over_wavelength(
    speed_m_s: float, wavelength_mm: float
) -> None:
    what = body(
        gravity_m_s2=0.0, brush_n_per_m=50.0
    )  # stiff, or its stretch follows the sine late
    texture = make("texture", wavelength_mm=wavelength_mm, depth=0.2)
    _, shear_n = run(
        what,
        8e-4,
        1500,
        PhysicsEffects(textures=(texture,)),
        inputs=lambda t: Inputs(shut(), (carry(speed_m_s=speed_m_s, t_s=t),)),
        watch=lambda state: what.brush_n_per_m[0, 0, 0] * state.stretch_m[0, 0, 0, 0],
    )
    steady = shear_n[-1250:]  # one second: a bin is a hertz
    tone = np.abs(np.fft.rfft(steady - steady.mean())) * 2.0 / len(steady)
    assert tone.argmax() == pytest.approx(speed_m_s / (1e-3 * wavelength_mm), abs=1.0)
    assert tone.max() == pytest.approx(0.2 * 0.6 * 1000.0 * DEPTH_M, rel=0.05)


# lag


def test_a_held_finger_relaxes_with_the_time_constant_of_its_silicone() -> None:
    what = body(gravity_m_s2=0.0)
    time_s = 0.2
    dt_s = 5e-4
    lag = make("lag", ratio=0.4, time_s=time_s)
    state = at_rest(what, shut(depth_m=0.0))
    _, normal_n = run(
        what,
        dt_s,
        1200,
        PhysicsEffects(lags=(lag,)),
        watch=lambda state: state.normal_n[:, 0].copy(),
        state=state,
    )
    t_s = dt_s * np.arange(1, 1201)[:, None]
    expected = FINGERS * DEPTH_M * (1.0 + 0.4 * np.exp(-t_s / time_s))
    assert np.allclose(normal_n, expected, rtol=2e-3)


# rotation


def torque_nm(what: Body, state: State) -> FloatArray:
    """[B] about x, of the fingers on the object."""
    lever = what.at_m - state.position_m[1:, None]
    force = -(what.brush_n_per_m * state.stretch_m).sum(axis=1)
    turned: FloatArray = (lever[0] * force[1] - lever[1] * force[0]).sum(axis=0)
    return turned


def test_friction_that_can_hold_an_offset_weight_holds_it_and_nothing_creeps() -> None:
    what = body(elements=5)
    rotation = make("rotation", offset_y_mm=10.0, offset_z_mm=4.0)
    turns = PhysicsEffects(turns=(rotation,))
    state, _ = run(what, 1e-3, 500, turns)
    for dt_s in (1e-2, 1e-3):
        run(what, dt_s, 600, turns, state=state)
    angle = rotation.angle.copy()
    stretch = state.stretch_m.copy()
    assert (np.abs(angle) > 1e-4).all()  # it gives way elastically
    y_m = rotation.place_m()[0]
    assert torque_nm(what, state) == pytest.approx(0.1 * 9.81 * y_m, rel=1e-6)
    for dt_s in (1e-3, 1e-2):
        run(what, dt_s, 300, turns, state=state)
    assert np.abs(rotation.angle - angle).max() < 1e-15
    assert np.abs(state.stretch_m - stretch).max() < 1e-15
    assert np.abs(rotation.rate).max() < 1e-15


def test_a_weight_on_a_pivot_swings_as_a_pendulum() -> None:
    what = body(at_m=np.zeros((2, 6)), brush_n_per_m=1000.0, loss_s=0.0)
    rotation = make("rotation", offset_y_mm=0.0, offset_z_mm=-50.0)
    rotation.angle[:] = 0.05
    _, angle = run(
        what,
        1e-3,
        2000,
        PhysicsEffects(turns=(rotation,)),
        watch=lambda _: rotation.angle[0],
    )
    falling = np.flatnonzero((angle[:-1] > 0.0) & (angle[1:] <= 0.0))
    assert len(falling) > 3
    inertia_m2 = gyration_m2(OBJECTS["basket-ball"]) + 0.05**2
    expected_s = 2.0 * np.pi * np.sqrt(inertia_m2 / (9.81 * 0.05))
    assert np.diff(falling).mean() * 1e-3 == pytest.approx(expected_s, rel=0.01)
    assert np.abs(angle[-1000:]).max() > 0.04


def test_an_object_turns_freely_only_where_no_person_holds_it() -> None:
    what = body()
    rotation = make("rotation", offset_y_mm=30.0, offset_z_mm=0.0)
    turns = PhysicsEffects(turns=(rotation,))
    run(
        what,
        1e-3,
        300,
        turns,
        inputs=lambda t: Inputs(shut(), (carry(stiff=1.0, share=1.0),)),
    )
    assert np.abs(rotation.angle).max() < 1e-6
    rotation.rate[:] = 2.0
    start = rotation.angle.copy()
    run(what, 1e-3, 300, turns, inputs=lambda t: Inputs(shut(depth_m=-1.0)))
    assert np.allclose(rotation.rate, 2.0)
    assert np.allclose(rotation.angle - start, 0.6)


def test_a_steady_acceleration_of_the_hand_turns_an_object_as_gravity_does() -> None:
    """Gravity and a hand that accelerates the other way cannot be told apart (Einstein, 1907)."""
    hand_m_s2 = np.array([0.0, 4.0, -3.0])
    turned = []
    for shaken in (True, False):
        rotation = make("rotation", offset_y_mm=10.0, offset_z_mm=40.0)
        what = body(elements=5, at_m=ALONG / 3.0)
        steady = SimpleNamespace(
            acceleration_m_s2=lambda t_s: np.outer(hand_m_s2, np.ones(2))
        )
        effects = PhysicsEffects(shakes=(steady,), turns=(rotation,))
        if not shaken:
            what = replace(
                what, gravity_m_s2=what.gravity_m_s2 - hand_m_s2[:, None] * np.ones(2)
            )
            effects = PhysicsEffects(turns=(rotation,))
        run(what, 1e-3, 600, effects)
        turned.append(rotation.angle.copy())
    assert np.abs(turned[0]).min() > 1e-3
    assert turned[0] == pytest.approx(turned[1], rel=1e-6)


# arm, tremor


def integral(values: FloatArray, dt_s: float) -> FloatArray:
    """Cumulative, by trapezes, from zero."""
    steps = 0.5 * (values[1:] + values[:-1]) * dt_s
    return np.concatenate([np.zeros_like(values[:1]), np.cumsum(steps, axis=0)])


def over(effect: Any, t_s: np.ndarray, batch: int = 2) -> FloatArray:
    """[T, 3, B] accelerations."""
    return np.array([effect.acceleration_m_s2(np.full(batch, t)) for t in t_s])


@pytest.mark.parametrize("count", [1.0, 2.0, 3.0])
def test_an_arm_comes_to_rest_where_its_motion_says(count: int) -> None:
    arm = make("arm", amplitude_m=0.2, lasts_s=0.8, rest_s=0.3, at_s=0.5, count=count)
    dt_s = 1e-3
    t_s = dt_s * np.arange(5000)
    acceleration = over(arm, t_s)
    speed = integral(acceleration, dt_s)
    place = integral(speed, dt_s)
    assert np.abs(speed[-1]).max() < 1e-5
    for k in range(2):
        assert np.allclose(place[:, :, k], arm.motion_m(t_s, k), atol=1e-5)
    assert np.linalg.norm(place[-1], axis=0) == pytest.approx(
        0.2 * (count % 2), abs=1e-5
    )
    assert np.linalg.norm(acceleration, axis=1).max() == pytest.approx(
        10.0 / np.sqrt(3.0) * 0.2 / 0.8**2, rel=1e-3
    )
    assert arm.peak_m_s2({"amplitude_m": 0.2, "lasts_s": 0.8}) == pytest.approx(
        np.linalg.norm(acceleration, axis=1).max(), rel=1e-3
    )


def test_an_arm_asks_for_fine_steps_in_every_movement_and_only_there() -> None:
    arm = make("arm", amplitude_m=0.2, lasts_s=0.8, rest_s=0.3, at_s=0.5, count=2.0)
    t_s = 1e-3 * np.arange(5000)
    moves = (over(arm, t_s) != 0.0).any(axis=(1, 2))
    spans = arm.busy_s(0)
    within = np.any([(t_s > start) & (t_s < stop) for start, stop in spans], axis=0)
    assert len(spans) == 2
    assert not (moves & ~within).any()
    assert moves.sum() > 0.95 * within.sum()


@pytest.mark.parametrize("frequency_hz", [4.0, 8.0, 12.0])
def test_a_tremor_trembles_at_its_frequency(frequency_hz: float) -> None:
    tremor = make("tremor", batch=20, frequency_hz=frequency_hz, amplitude_m_s2=0.5)
    values = over(tremor, 2e-3 * np.arange(10000), batch=20)
    power = (
        np.abs(np.fft.rfft(values * np.hanning(10000)[:, None, None], axis=0)) ** 2
    ).sum(axis=1)
    bins_hz = np.fft.rfftfreq(10000, 2e-3)
    near = (bins_hz > 0.84 * frequency_hz) & (bins_hz < 1.16 * frequency_hz)
    assert (power[near].sum(axis=0) > 0.999 * power.sum(axis=0)).all()
    peak_m_s2 = tremor.peak_m_s2({"amplitude_m_s2": 0.5})
    assert 0.5 * peak_m_s2 < np.linalg.norm(values, axis=1).max() <= peak_m_s2
    mean_square = (
        (values * values).sum(axis=1).mean(axis=0)
    )  # of two sines of half the amplitude
    assert np.median(mean_square) == pytest.approx(0.5 * 2 * 0.25**2, rel=0.02)
    assert tremor.busy_s(0)[0][1] > 1e6


def test_an_object_that_nothing_holds_stays_where_it_is_while_the_hand_reaches() -> (
    None
):
    arm = make("arm", amplitude_m=0.2, lasts_s=0.8, rest_s=0.3, at_s=0.1, count=1.0)
    what = body(gravity_m_s2=0.0)
    open_hand = Inputs(shut(depth_m=-1.0))
    reached = PhysicsEffects(shakes=(arm,))
    state, _ = run(what, 1e-3, 1000, reached, inputs=lambda t: open_hand)
    for k in range(2):
        # in the frame of the hand it has moved against the hand's way
        (moved,) = arm.motion_m(np.array([1.0]), k)
        assert np.linalg.norm(moved) == pytest.approx(0.2)
        assert state.position_m[:, k] == pytest.approx(-moved, abs=1e-3)


# all


def held_j(what: Body, state: State, rotation: Rotation, lag: Lag) -> FloatArray:
    """[B] all the energy there is: of motion, in springs, brushes and branches, in height."""
    spin = 0.5 * what.mass_kg * rotation.inertia_m2 * rotation.rate**2
    branch = 0.5 * (lag.held_n**2 / lag.stiffness).sum(axis=0)
    at = state.position_m.copy()
    at[1:] += rotation.place_m()
    height = -(what.mass_kg * what.gravity_m_s2 * at).sum(axis=0)
    springs = state.brush_j + normal_j(
        what, shut(len(at[0])), state.position_m[0], state.recess_m
    )
    total: FloatArray = kinetic_j(what, state) + spin + branch + springs + height
    return total


def gains_j(
    step_s: float, elements: int, lagging: bool
) -> tuple[FloatArray, FloatArray]:
    """[K, B] what every step added to the energy of a kicked object that only the hand touches;
    and what was left."""
    batch = 16
    rng = np.random.default_rng(3)
    what = body(
        batch,
        elements,
        per_m=1.0 / 0.03,
        damping_s=2e-3,
        gravity_m_s2=2.0,
        at_m=0.2 * ALONG,
    )
    lag = make("lag", batch)
    texture = make("texture", batch)
    rotation = make("rotation", batch, offset_y_mm={"uniform": [-30, 30]})
    effects = PhysicsEffects(
        textures=(texture,), lags=(lag,) if lagging else (), turns=(rotation,)
    )
    state = at_rest(what, shut(batch))
    state.velocity_m_s += rng.normal(size=(3, batch)) * 0.1
    rotation.rate += rng.normal(size=batch) * 5.0
    energy = [held_j(what, state, rotation, lag)]
    gripped = []
    for _ in range(200):
        dt_s = step_s * 10.0 ** rng.uniform(-0.5, 0.0, batch)
        step(what, state, Inputs(shut(batch)), dt_s, dt_s, effects)
        energy.append(held_j(what, state, rotation, lag))
        # it does not turn a weight that no hand holds
        gripped.append((state.normal_n > 0.0).any(axis=0))
    return np.where(gripped, np.diff(energy, axis=0), 0.0), np.array(energy)


@pytest.mark.parametrize("step_s", [1e-5, 1e-4, 1e-3, 1e-2, 1e-1, 1.0])
@pytest.mark.parametrize("elements", [1, 5])
@pytest.mark.parametrize("lagging", [False, True])
def test_no_step_makes_energy_with_rotation_and_texture(
    step_s: float, elements: int, lagging: bool
) -> None:
    gains, energy = gains_j(step_s, elements, lagging)
    assert np.isfinite(energy).all()
    assert gains.max() < 1e-12
