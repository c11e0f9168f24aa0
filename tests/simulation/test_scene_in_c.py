"""The page's physics in C moves as the scenes' own does: same inputs, same forces and places."""

from __future__ import annotations

import ctypes
import subprocess
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import pytest
from c_form import STRICT, require_compiler

from examples.browser.setups import ELEMENTS, body_numbers, trial_of
from holdfast.core.contract import FloatArray
from holdfast.simulation.loop.drive import Actuator, Drive
from holdfast.simulation.physics.body import Body, Inputs, Pull, State, at_rest
from holdfast.simulation.physics.contacts import pressure
from holdfast.simulation.physics.solver import step
from holdfast.simulation.scenes.script import body_of
from holdfast.simulation.scenes.stepper import forces_of

SOURCES = Path(__file__).resolve().parents[2] / "examples/browser"
DT_S = 1.0 / 1200.0
STEPS = 500
RELATIVE = 1e-6
"""Largest difference of a force or a place, over the largest of its trial."""
GRIP_N = 8.0


def numbers(count: int) -> ctypes.Array[ctypes.c_double]:
    return (ctypes.c_double * count)()


@pytest.fixture(scope="module")
def scene(tmp_path_factory: pytest.TempPathFactory) -> ctypes.CDLL:
    made = tmp_path_factory.mktemp("scene") / "scene.so"
    words = [require_compiler(), *STRICT, "-O2", "-fPIC", "-shared", "-o", str(made)]
    done = subprocess.run([*words, str(SOURCES / "scene.c"), "-lm"])
    assert done.returncode == 0
    library = ctypes.CDLL(str(made))
    library.scene_drive_step.restype = ctypes.c_double
    real, place = ctypes.c_double, ctypes.c_void_p
    library.scene_drive_step.argtypes = [place, real, real, real]
    library.scene_step.argtypes = [place, place, place, place, ctypes.c_int, real]
    return library


@dataclass(frozen=True)
class Hand:
    """An object in a hand: grip and the puller's target at a time, and the way gravity points."""

    name: str
    grip_n: Callable[[float], float]
    target_m: Callable[[float], tuple[float, float, float]]
    stiffness: float = 500.0
    cap_n: float = 40.0
    down: tuple[float, float, float] = (0.0, 0.0, -1.0)
    friction: float | None = None


def grows(t_s: float, from_s: float, lasts_s: float = 0.15) -> float:
    return float(np.clip((t_s - from_s) / lasts_s, 0.0, 1.0))


def still(t_s: float) -> tuple[float, float, float]:
    return (0.0, 0.0, 0.0)


def torn(t_s: float) -> tuple[float, float, float]:
    return (0.002 * grows(t_s, 0.1), 0.01 * grows(t_s, 0.1), 0.25 * grows(t_s, 0.1))


HANDS = {
    "a pull that friction withstands": Hand(
        "full-bottle",
        lambda t: GRIP_N,
        lambda t: (0.0, 0.0, -0.006 * grows(t, 0.2)),
    ),
    "a ball torn out": Hand("soft-ball", lambda t: 3.0, torn),
    "a caught slip": Hand(
        "full-bottle",
        lambda t: 2.0 + 18.0 * grows(t, 0.06, 0.1),
        still,
        stiffness=0.0,
    ),
    "a pull across the fingers, thumb below": Hand(
        "hard-ball",
        lambda t: GRIP_N,
        lambda t: (0.02 * grows(t, 0.2), 0.03 * grows(t, 0.2), 0.0),
        down=(-1.0, 0.0, 0.0),
    ),
    "upside down, slippery": Hand(
        "apple", lambda t: 6.0, torn, down=(0.0, 0.0, 1.0), friction=0.2
    ),
}


def bodies(hand: Hand) -> Body:
    """Two equal trials: numpy sums a single one in another order than many."""
    trial = trial_of(hand.name)
    body = body_of([trial, trial], pressure(ELEMENTS))
    changes = {"gravity_m_s2": 9.81 * np.array(hand.down)[:, None] * np.ones(2)}
    if hand.friction is not None:
        changes |= {"static": hand.friction * np.ones(2)}
        changes |= {"kinetic": 0.8 * hand.friction * np.ones(2)}
    return Body(**(vars(body) | changes))


def inputs_of(hand: Hand, body: Body) -> Iterator[tuple[FloatArray, Pull]]:
    share = trial_of(hand.name).share
    damping = 1.4 * np.sqrt(hand.stiffness * body.mass_kg)
    before = np.zeros(3)
    for k in range(STEPS):
        t_s = (k + 1) * DT_S
        closure_m = hand.grip_n(t_s) * share / body.stiffness_n_per_m[:, 0]
        target_m = np.array(hand.target_m(t_s))
        speed = (target_m - before) / DT_S
        before = target_m
        one = np.ones(2)
        yield (
            closure_m,
            Pull(
                stiffness_n_per_m=hand.stiffness * one,
                damping_n_s_per_m=damping,
                cap_n=hand.cap_n * one,
                weight_share=0.0 * one,
                target_m=target_m[:, None] * one,
                target_m_s=speed[:, None] * one,
            ),
        )


@cache
def of_python(hand: Hand) -> tuple[FloatArray, FloatArray]:
    """[K, 6, 3] forces and [K, 3] places of the scenes' core."""
    body = bodies(hand)
    state: State | None = None
    forces, places = [], []
    for closure_m, pull in inputs_of(hand, body):
        both_m = closure_m[:, None] * np.ones(2)
        state = at_rest(body, both_m) if state is None else state
        dt_s = np.full(2, DT_S)
        step(body, state, Inputs(both_m, (pull,)), dt_s, dt_s)
        forces.append(forces_of(body, state)[..., 0].copy())
        places.append(state.position_m[:, 0].copy())
    return np.array(forces), np.array(places)


def of_c(scene: ctypes.CDLL, hand: Hand) -> tuple[FloatArray, FloatArray]:
    """The same of scene.c."""
    flat = body_numbers(bodies(hand))
    body, state = (ctypes.c_double * len(flat))(*flat), numbers(400)
    forces, places, force_n = [], [], numbers(18)
    for k, (closure_m, pull) in enumerate(inputs_of(hand, bodies(hand))):
        closed = (ctypes.c_double * 6)(*closure_m)
        if k == 0:
            scene.scene_rest(body, closed, state)
        person = np.concatenate(
            [np.ravel(part[..., 0]) for part in vars(pull).values()]
        )
        people = (ctypes.c_double * 10)(*person)
        scene.scene_step(body, state, closed, people, 1, DT_S)
        scene.scene_forces(body, state, force_n)
        forces.append(np.array(force_n).reshape(6, 3))
        places.append(np.array(state[:3]))
    return np.array(forces), np.array(places)


@pytest.mark.parametrize("hand", HANDS.values(), ids=list(HANDS))
def test_an_object_in_c_moves_as_in_the_scenes(scene: ctypes.CDLL, hand: Hand) -> None:
    wanted, got = of_python(hand), of_c(scene, hand)
    for right, left in zip(wanted, got, strict=True):
        assert np.abs(left - right).max() <= RELATIVE * np.abs(right).max()


def test_the_drive_in_c_is_that_of_the_scenes(scene: ctypes.CDLL) -> None:
    trial = trial_of("full-bottle")
    actuator = Actuator(Drive(), [trial, trial])
    figures = [0.05, actuator.fastest_n_s[0], 70.0, actuator.backlash_n[0]]
    drive = (ctypes.c_double * 8)(*figures, *3 * [trial.grip_n], 0.0)
    rng = np.random.default_rng(3)
    for _ in range(40):
        target_n = float(rng.choice([0.0, 5.0, 12.0, 30.0, 90.0]))
        own_n = trial.grip_n * float(rng.choice([1.0, 1.0, 0.5]))
        for _ in range(60):
            wanted = actuator.step(np.full(2, target_n), DT_S, np.full(2, own_n))[0]
            got = scene.scene_drive_step(drive, target_n, own_n, DT_S)
            assert got == pytest.approx(wanted, rel=1e-12, abs=1e-12)
