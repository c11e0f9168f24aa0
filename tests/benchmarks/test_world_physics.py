"""Whether the second physics is one: it holds, slides, falls, and makes no energy.

Skipped where MuJoCo is absent (`make world` installs it, in an environment of its own).
"""

from __future__ import annotations

from dataclasses import replace
from functools import cache

import numpy as np
import pytest

pytest.importorskip(
    "mujoco", reason="MuJoCo is only in the environment of `make world`"
)

from benchmarks.world.draws import WorldTrial, draw_trial
from benchmarks.world.hand import World
from benchmarks.world.outcomes import BareRun, bare_run, closed_from_onset, slid_mm
from holdfast.simulation.loop.drive import OPENINGS

DEVELOPMENT = 150
PADS = ("point", "grid")


@cache
def plain(kind: str = "quiet-hold", **changes: float) -> WorldTrial:
    """A box of 200 g in a firm hold at friction 0.5, weight along the skin, still."""
    drawn = draw_trial(kind, 0, DEVELOPMENT)
    fixed = {
        "mass_kg": 0.2,
        "friction": 0.5,
        "half_width_m": 0.03,
        "half_depth_m": 0.03,
        "half_length_m": 0.05,
        "finger_n_per_m": 800.0,
        "shear_ratio": 1.2,
        "tremor_m_s2": 0.0,
        "fluctuation": 0.0,
    }
    numbers = drawn.numbers | fixed | changes
    share = np.array([0.5, 0.5, 0.25, 0.25, 0.25, 0.25])
    # Coulomb: both sides hold 0.2 kg with friction 0.5
    need_n = 0.2 * 9.81 / (2.0 * 0.5)
    return replace(
        drawn,
        numbers=numbers,
        shape="box",
        centre_m=np.zeros(3),
        grab_m=np.zeros(3),
        gravity_m_s2=np.array([0.0, 0.0, -9.81]),
        share=share,
        stiffness=np.full(6, 800.0),
        grip_n=need_n / 0.7,
        need_n=need_n,
        push=np.array([0.0, 0.0, -1.0]),
    )


def run_to(world: World, t_s: float) -> World:
    while world.t_s < t_s:
        world.advance(0.0)
    return world


@pytest.mark.parametrize("pads", PADS)
def test_a_hold_at_seven_tenths_of_friction_does_not_creep(pads: str) -> None:
    trial = plain()
    world = run_to(World(trial, pads), trial.give_s + trial.numbers["give_s"] + 0.2)
    from_m = world.contact_places_m()
    run_to(world, world.t_s + 1.0)
    assert world.gripped
    assert slid_mm(world, from_m) < 0.02


@pytest.mark.parametrize("pads", PADS)
def test_fingers_bear_the_grip_and_the_weight(pads: str) -> None:
    trial = plain()
    world = run_to(World(trial, pads), trial.act_s)
    forces_n = world.forces_n()
    assert forces_n[:2, 2].sum() == pytest.approx(trial.grip_n, rel=0.03)
    assert forces_n[2:, 2].sum() == pytest.approx(trial.grip_n, rel=0.03)
    weight_n = -(forces_n[:2, 1] * -1.0).sum() - forces_n[2:, 1].sum()
    assert abs(weight_n) == pytest.approx(0.2 * 9.81, rel=0.03)


def test_what_friction_cannot_hold_slides_and_what_it_can_stays() -> None:
    for grip, stays in ((1.2, True), (0.8, False)):
        trial = replace(plain(), grip_n=grip * plain().need_n)
        world = run_to(World(trial, "point"), trial.give_s + trial.numbers["give_s"])
        from_m = world.contact_places_m()
        run_to(world, world.t_s + 0.3)
        kept = world.gripped and slid_mm(world, from_m) < 0.5
        assert kept == stays


def test_an_object_that_no_finger_holds_falls_freely() -> None:
    trial = replace(plain(), close_s=10.0, give_s=0.2, act_s=0.2)
    gone_s = trial.give_s + trial.numbers["give_s"]
    world = run_to(World(trial, "point"), gone_s + 0.01)
    from_m = world.motion().place_m
    from_m_s = world.motion().speed_m_s
    begun_s = world.t_s
    run_to(world, begun_s + 0.2)
    t_s = world.t_s - begun_s
    # the step of the integrator, 0.8 ms, is 0.4 % of this
    expected_m = from_m + t_s * from_m_s + 0.5 * t_s**2 * trial.gravity_m_s2
    assert world.motion().place_m == pytest.approx(expected_m, abs=2e-3)


@pytest.mark.parametrize("pads", PADS)
def test_a_held_object_left_alone_gains_no_energy(pads: str) -> None:
    trial = plain()
    world = run_to(World(trial, pads), trial.give_s + trial.numbers["give_s"] + 0.02)
    before_j = world.energy_j()
    for _ in range(60):
        world.advance(0.0)
        after_j = world.energy_j()
        # a micro-joule: the weight falls through 0.5 um
        assert after_j <= before_j + 1e-6
        before_j = after_j


def test_outer_points_of_a_grid_slide_before_the_pad_does() -> None:
    """On a curved object the outer points bear less, so they reach their friction first."""
    trial = replace(plain(), shape="ball", grip_n=plain().need_n / 0.75)
    world = run_to(World(trial, "grid"), trial.give_s)
    data = world._data
    normals = world._model.qpos_spring[world._normals] - data.qpos[world._normals]
    assert normals[0].max() > 1.3 * normals[0].min()


def bare(kind: str, **changes: float) -> BareRun:
    found = bare_run(plain(kind, **changes), "point")
    assert isinstance(found, BareRun)
    return found


def test_a_tug_that_friction_holds_stays_and_one_beyond_it_does_not() -> None:
    pull = {"arm_n_per_m": 2000.0, "fast_s": 0.3, "pull_m": 0.2}
    held = bare("pull-fast", force_n=0.4, **pull)
    lost = bare("pull-fast", force_n=3.0, **pull)
    assert np.isinf(held.outcome.lost_s)
    assert np.isfinite(lost.outcome.lost_s)


def test_a_hand_that_closes_at_load_onset_keeps_what_the_bare_hand_loses() -> None:
    pull = {"arm_n_per_m": 500.0, "slow_s": 1.0, "pull_m": 0.2, "force_n": 3.0}
    run = bare("pull-slow", **pull)
    assert np.isfinite(run.outcome.lost_s)
    assert np.isinf(closed_from_onset(run, 70.0).lost_s)
    assert np.isfinite(closed_from_onset(run, 0.0).lost_s)


def test_the_wearers_opening_ends_a_target_in_a_hand_that_can_tell() -> None:
    grips_n = {}
    for opening in OPENINGS:
        trial = plain("put-down")
        world = World(trial, "point", opening)
        while world.t_s < trial.open_s + 0.3:
            world.advance(20.0 if world.t_s > trial.act_s else 0.0)
        grips_n[opening] = float(world.drive.grip_n[0])
    assert grips_n["wearer"] < 1.0
    assert grips_n["larger"] == pytest.approx(20.0, abs=1.0)
