"""Our own core on the hold and pull of mujoco_scene.py: the same scene, springs and measures.

Both step everything at one fixed step. What a scene does beside (fine steps only where something
can happen) is not in these figures.
"""

from __future__ import annotations

import json
import time
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from benchmarks.mujoco_peer import SLIP_TRAVEL_M, STEPS_S
from benchmarks.mujoco_scene import GRAVITY_M_S2, Scene
from holdfast.core.contract import FloatArray
from holdfast.core.reading import Json
from holdfast.simulation.body import SIDE, Body, Inputs, Pull, State, at_rest
from holdfast.simulation.contacts import pressure
from holdfast.simulation.core import step

GRIP_SHARE = np.array([0.5, 0.5, 0.25, 0.25, 0.25, 0.25])[:, None]
LANES = (2, 200)
"""Trials at once: as good as alone, and as a set is simulated."""
ELEMENTS = 5


@dataclass(frozen=True)
class SolverRow:
    """The hold and the pulls of one solver. creep_mm: how far the object sank from 1 s on.

    A pull of 8 N must hold and one of 16 N must slip (Coulomb: 14.4 N); None: it held.
    """

    solver: str
    step_ms: float
    cpu_ms_per_s: float
    held_s: float
    creep_mm: float | None
    slip_8n_ms: float | None
    slip_16n_ms: float | None


def rows(peers: Path, scene: Scene | None = None) -> list[SolverRow]:
    """One row per solver and step: ours, then those that `make peers` wrote, if any."""
    scene = scene or Scene()
    ours = [measure(scene, step_s, lanes) for lanes in LANES for step_s in STEPS_S]
    file = peers / "mujoco.json"
    if not file.is_file():
        return ours
    peer = json.loads(file.read_text("utf-8"))
    return ours + [_peer(run, peer["versions"]["mujoco"]) for run in peer["runs"]]


def measure(scene: Scene, step_s: float, lanes: int) -> SolverRow:
    """Hold for scene.hold_s, then each pull from a hold of its own."""
    held = Held(scene, step_s, lanes)
    cpu_s = held.run(scene.settled_s)
    from_m = held.state.position_m[2].copy()
    cpu_s += held.run(scene.hold_s - scene.settled_s)
    creep_m = float(np.abs(held.state.position_m[2] - from_m).max())
    pulls = [pull(scene, step_s, cap_n) for cap_n in scene.caps_n]
    return _row(
        f"ours, {lanes} at once",
        step_s,
        cpu_s / scene.hold_s / lanes,
        scene.hold_s,
        creep_m,
        pulls,
    )


def pull(scene: Scene, step_s: float, cap_n: float) -> float | None:
    """When the object has slid 2 mm along the pads, s from the pull's begin, or None."""
    held = Held(scene, step_s, LANES[0])
    held.run(scene.settled_s)
    lead_m = scene.pull_m_s * scene.arm_n_s_per_m / scene.arm_n_per_m
    z_m = held.state.position_m[2, 0]
    travel_m = 0.0
    one = np.ones(LANES[0])
    for k in range(round(scene.pull_s / step_s)):
        target = np.zeros((3, LANES[0]))
        target[2] = z_m - scene.pull_m_s * (k + 1) * step_s - lead_m
        person = Pull(
            scene.arm_n_per_m * one,
            scene.arm_n_s_per_m * one,
            cap_n * one,
            0.0 * one,
            target,
            np.zeros_like(target),
        )
        held.run(step_s, (person,))
        travel_m += float(held.state.slip_m_s[..., 0].mean()) * step_s
        if travel_m > SLIP_TRAVEL_M:
            return (k + 1) * step_s
    return None


@dataclass
class Held:
    """A cylinder in the hand, from rest."""

    scene: Scene
    step_s: float
    lanes: int

    def __post_init__(self) -> None:
        self.body = body(self.scene, self.lanes)
        self.closure_m: FloatArray = (
            GRIP_SHARE * self.scene.grip_n / self.body.stiffness_n_per_m
        )
        self.state: State = at_rest(self.body, self.closure_m)
        self.dt_s = np.full(self.lanes, self.step_s)

    def run(self, lasts_s: float, people: tuple[Pull, ...] = ()) -> float:
        """Step on; returns the CPU time, s."""
        inputs = Inputs(self.closure_m, people)
        started = time.process_time()
        for _ in range(round(lasts_s / self.step_s)):
            step(self.body, self.state, inputs, self.dt_s, self.dt_s)
        return time.process_time() - started


def body(scene: Scene, lanes: int) -> Body:
    """The peer's scene as a body of ours; one coefficient of friction, as MuJoCo has."""
    one = np.ones(lanes)
    each = np.ones((len(SIDE), lanes))
    return Body(
        mass_kg=scene.mass_kg * one,
        gravity_m_s2=np.array([0.0, 0.0, -GRAVITY_M_S2])[:, None] * one,
        curvature_per_m=np.array([1.0 / scene.radius_m, 0.0])[:, None] * one,
        straight_m=scene.half_length_m * one,
        at_m=np.zeros((2, len(SIDE), lanes)),
        stiffness_n_per_m=scene.normal_n_per_m * each,
        damping_n_s_per_m=scene.finger_loss_s * scene.normal_n_per_m * each,
        brush_n_per_m=scene.along_n_per_m
        / ELEMENTS
        * np.ones((ELEMENTS, len(SIDE), lanes)),
        pressure=pressure(ELEMENTS)[:, None, None],
        static=scene.friction * one,
        kinetic=scene.friction * one,
        loss_s=scene.finger_loss_s,
    )


def _peer(run: Json, version: str) -> SolverRow:
    slips = [pull["slip_s"] for pull in run["pulls"]]
    name = f"MuJoCo {version}, {run['variant']}"
    return _row(
        name, run["step_s"], run["cpu_s_per_s"], run["held_s"], run["creep_m"], slips
    )


def _row(
    solver: str,
    step_s: float,
    cpu_s_per_s: float,
    held_s: float,
    creep_m: float | None,
    slips_s: list[float | None],
) -> SolverRow:
    weak_ms, strong_ms = (
        None if slip_s is None else 1e3 * slip_s for slip_s in slips_s
    )
    creep_mm = None if creep_m is None else 1e3 * creep_m
    cpu_ms_per_s = 1e3 * cpu_s_per_s
    return SolverRow(
        solver, 1e3 * step_s, cpu_ms_per_s, held_s, creep_mm, weak_ms, strong_ms
    )
