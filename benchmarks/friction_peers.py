"""Three laws of friction for one block on one contact: why our scenes use the set-valued one.

Regularised Coulomb friction, mu N tanh(v / v0), is what most simulators do because it is a smooth
function of the velocity. It is the thing not done here: at zero velocity its force is zero, so
whatever is held must move, at v0 atanh(share of the limit) - a millimetre a second at the usual v0,
for ever. A held object sinks out of a resting hand, "before the slip" does not exist as a state,
and a predictor learns the creep of the simulator. A smaller v0 creeps less and is stiffer by as
much. LuGre has a state, its bristles, and does not creep under a constant load, but it drifts under
any small vibration far below the limit, as the bristles slide a little in every cycle (Dupont,
Hayward, Armstrong & Altpeter, "Single state elastoplastic friction models", IEEE Trans. Autom.
Control 47, 2002), and a load between kinetic and static friction then gets away altogether. Nor can
its bristles be as soft as a fingertip: their stretching counts as slip speed, so that loading alone
takes the static friction away. Set-valued friction by return mapping (`simulation.core`) holds
exactly, and needs no smaller step for it.

The task: a load along the contact rises smoothly to a share of the static limit in the first half
second and stays, with or without a small vibration on it. Creep is how far the block moves from 1 s
on. Arrays are [B], a lane a case.
"""

from __future__ import annotations

import time
from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike

from holdfast.core.contract import FloatArray

RAMP_S = 0.5
SETTLED_S = 1.0
HELD_S = 60.0
SHARES = (0.5, 0.9)
VIBRATION = 0.05
"""Amplitude of the vibration over the limit: the load stays below it even at the share of 0.9."""
VIBRATION_HZ = 10.0
"""The hand's own tremor is at 8 to 12 Hz."""
LOST_M = 0.06
"""Who moves so far has let the ball go."""
CHUNK = 1000


@dataclass(frozen=True)
class Block:
    """A sixth of the ball and of the grip: SI units."""

    mass_kg: float = 0.033
    normal_n: float = 4.0
    static: float = 0.6
    kinetic: float = 0.5

    @property
    def limit_n(self) -> float:
        """The load at which it lets go."""
        return self.static * self.normal_n


BLOCK = Block()


@dataclass
class Moving:
    """State of the lanes [B]: position, velocity, stretch, whether the last step slid."""

    position_m: FloatArray
    velocity_m_s: FloatArray
    stretch_m: FloatArray
    slides: np.ndarray

    @staticmethod
    def still(lanes: int) -> Moving:
        """Nothing moves, nothing is stretched."""
        position_m, velocity_m_s, stretch_m = np.zeros((3, lanes))
        slides = np.zeros(lanes, dtype=np.bool_)
        return Moving(position_m, velocity_m_s, stretch_m, slides)


@dataclass(frozen=True)
class Regularised:
    """mu N tanh(v / v0); 1 mm/s is a usual v0. Linearly implicit in v, so the step does not limit
    v0."""

    v0_m_s: float = 1e-3
    step_s: float = 1e-3

    def step(
        self, block: Block, state: Moving, load_n: FloatArray, dt_s: float
    ) -> None:
        """One step."""
        bent = np.tanh(state.velocity_m_s / self.v0_m_s)
        slope = block.limit_n * (1.0 - bent * bent) / self.v0_m_s
        state.velocity_m_s += (
            dt_s * (load_n - block.limit_n * bent) / (block.mass_kg + dt_s * slope)
        )
        state.position_m += dt_s * state.velocity_m_s


@dataclass(frozen=True)
class LuGre:
    """Bristles with a state z: dz/dt = v - sigma0 |v| z / g(v), force sigma0 z + sigma1 dz/dt +
    sigma2 v.

    g(v) = mu_k N + (mu_s - mu_k) N exp(-(v / vs)^2); parameters of Canudas de Wit, Olsson, Astrom &
    Lischinsky, "A new model for control of systems with friction", IEEE Trans. Autom. Control 40,
    1995 (sigma0 in N/m, the others in N s/m, vs in m/s). Implicit in z and v with |v| / g(v) of the
    old velocity: stable, and of first order in the step: at 0.2 ms the drift under vibration is 0.2
    % above its limit for small steps.
    """

    sigma0: float = 1e5
    sigma1: float = 316.2
    sigma2: float = 0.4
    stribeck_m_s: float = 1e-3
    step_s: float = 2e-4

    def step(
        self, block: Block, state: Moving, load_n: FloatArray, dt_s: float
    ) -> None:
        """One step."""
        speed = np.abs(state.velocity_m_s)
        kinetic_n = block.kinetic * block.normal_n
        g = kinetic_n + (block.limit_n - kinetic_n) * np.exp(
            -((speed / self.stribeck_m_s) ** 2)
        )
        rate = self.sigma0 * speed / g
        kept = 1.0 / (1.0 + dt_s * rate)
        # force a unit of the new z; the new z is kept * (z + dt v)
        bristle = self.sigma0 - self.sigma1 * rate
        mass = block.mass_kg + dt_s * (
            bristle * kept * dt_s + self.sigma1 + self.sigma2
        )
        drive = block.mass_kg * state.velocity_m_s + dt_s * (
            load_n - bristle * kept * state.stretch_m
        )
        state.velocity_m_s = drive / mass
        state.stretch_m = kept * (state.stretch_m + dt_s * state.velocity_m_s)
        state.position_m += dt_s * state.velocity_m_s


@dataclass(frozen=True)
class SetValued:
    """A spring of at most mu N, by return mapping, implicit in v; mu falls from static to kinetic
    while it slides.

    stiffness and loss (a damping over the stiffness, none while it slides) are those of a finger of
    our scenes.
    """

    stiffness_n_per_m: float = 500.0
    loss_s: float = 2e-3
    step_s: float = 1e-3

    def step(
        self, block: Block, state: Moving, load_n: FloatArray, dt_s: float
    ) -> None:
        """One step: try to stick; where the spring would have to hold more than it can, slide."""
        spring = self.stiffness_n_per_m
        mass = block.mass_kg
        limit_n = np.where(state.slides, block.kinetic, block.static) * block.normal_n
        drive = mass * state.velocity_m_s + dt_s * load_n
        stick = (drive - dt_s * spring * state.stretch_m) / (
            mass + dt_s * (dt_s + self.loss_s) * spring
        )
        trial_m = state.stretch_m + dt_s * stick
        state.slides = spring * np.abs(trial_m) > limit_n
        held_n = np.copysign(limit_n, trial_m)
        state.velocity_m_s = np.where(
            state.slides, (drive - dt_s * held_n) / mass, stick
        )
        state.stretch_m = np.where(state.slides, held_n / spring, trial_m)
        state.position_m += dt_s * state.velocity_m_s


Law = Regularised | LuGre | SetValued
"""Each has the step that it is run at."""


@dataclass(frozen=True)
class Task:
    """The load of every lane [B]: share of the static limit, amplitude of vibration over it."""

    share: FloatArray
    vibration: FloatArray
    block: Block = BLOCK

    @staticmethod
    def of(share: ArrayLike, vibration: ArrayLike = 0.0) -> Task:
        """From numbers or arrays that fit each other."""
        shares, vibrations = np.broadcast_arrays(
            np.atleast_1d(share), np.atleast_1d(vibration)
        )
        return Task(shares.astype(np.float64), vibrations.astype(np.float64))

    def load_n(self, t_s: FloatArray) -> FloatArray:
        """[n, B] load at times t_s [n]: a minimum-jerk rise of load and vibration, then both go
        on."""
        u = np.minimum(t_s / RAMP_S, 1.0)
        risen = u * u * u * (10.0 + u * (6.0 * u - 15.0))
        shaken = np.sin(2.0 * np.pi * VIBRATION_HZ * t_s)[:, None] * self.vibration
        load: FloatArray = self.block.limit_n * risen[:, None] * (self.share + shaken)
        return load


def path(law: Law, task: Task, times_s: FloatArray) -> FloatArray:
    """Position of the block at times_s [n] (rising, rounded to steps): m, [n, B]."""
    wanted = np.round(np.asarray(times_s) / law.step_s).astype(np.int64)
    return np.stack(list(_positions(law, task, wanted)))


def _positions(law: Law, task: Task, wanted: np.ndarray) -> Iterator[FloatArray]:
    dt_s = law.step_s
    state = Moving.still(len(task.share))
    done = 0
    for number in wanted:
        while done < number:
            more = np.arange(done, min(done + CHUNK, number))
            for load_n in task.load_n((more + 1) * dt_s):
                law.step(task.block, state, load_n, dt_s)
            done += len(more)
        yield state.position_m.copy()


def creep(law: Law, task: Task, held_s: float = HELD_S) -> FloatArray:
    """Motion of the block from SETTLED_S to held_s, m, [B], both at one phase of the vibration."""
    start, stop = path(law, task, np.array([SETTLED_S, held_s]))
    moved: FloatArray = stop - start
    return moved


def cost_ns(law: Law, lanes: int = 1000, steps: int = 500, repeats: int = 7) -> float:
    """CPU ns of one step of one lane: the least of some repeats; 1000 lanes, to exclude Python."""
    task = Task.of(np.linspace(0.1, 0.9, lanes))
    best = np.inf
    for _ in range(repeats):
        state = Moving.still(lanes)
        load_n = task.load_n(np.array([RAMP_S]))[0]
        started = time.process_time_ns()
        for _ in range(steps):
            law.step(task.block, state, load_n, law.step_s)
        best = min(best, (time.process_time_ns() - started) / (steps * lanes))
    return float(best)


LAWS: dict[str, Law] = {
    "regularised": Regularised(),
    "LuGre": LuGre(),
    "LuGre, soft as a finger": LuGre(sigma0=500.0, sigma1=1.0),
    "set-valued": SetValued(),
}
"""The second LuGre has the stiffness and damping of a finger of ours, as one who describes silicone
would choose."""


@dataclass(frozen=True)
class CreepRow:
    """How far a law lets the block move in held_s. share, vibration: of the friction limit.

    lets_go: it moved so far that nothing is held any more. cost_ns: CPU time of a step.
    cost_ns_per_s: what a second of one contact costs at the law's own step.
    """

    law: str
    share: float
    vibration: float
    held_s: float
    creep_m: float
    lets_go: bool
    step_s: float
    cost_ns: float
    cost_ns_per_s: float


def table(held_s: float = HELD_S) -> list[CreepRow]:
    """Rows of `make bench NAME=simulator`: every law at every share and vibration."""
    shares, vibrations = (
        grid.ravel() for grid in np.meshgrid(SHARES, (0.0, VIBRATION), indexing="ij")
    )
    rows = []
    for name, law in LAWS.items():
        price = cost_ns(law)
        moved = creep(law, Task.of(shares, vibrations), held_s)
        for share, vibration, moved_m in zip(shares, vibrations, moved, strict=True):
            rows.append(
                CreepRow(
                    law=name,
                    share=float(share),
                    vibration=float(vibration),
                    held_s=held_s,
                    creep_m=float(moved_m),
                    lets_go=bool(abs(moved_m) > LOST_M),
                    step_s=law.step_s,
                    cost_ns=price,
                    cost_ns_per_s=price / law.step_s,
                )
            )
    return rows
