"""Trials through the core, a batch at a time: forces at every sample, and what really happened."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from edge_runtime.contract import BoolArray, FloatArray
from simulation.core import Body, State, at_rest, step
from simulation.effect import NO_EFFECTS, PhysicsEffects
from simulation.protocol import Trial
from simulation.script import Grid, Interval, Script, body_of, grid_of

CHUNK = 64
SLIDES_M_S = 2e-4
"""Slower than this an element creeps about its equilibrium and does not slip."""
ONE_ELEMENT = np.ones(1)
IntArray = npt.NDArray[np.int64]


@dataclass(frozen=True)
class Loop:
    """How a batch is stepped: step_s where anything can happen, pressure [E] of the brush, effects, averaging.

    average_s: the sensor reports the mean over so long before each sample (0: the value at the sample).
    busy: further fine intervals of every lane.
    """

    rate_hz: float
    step_s: float
    pressure: FloatArray = field(default_factory=lambda: ONE_ELEMENT)
    effects: PhysicsEffects = NO_EFFECTS
    average_s: float = 0.0
    busy: tuple[tuple[Interval, ...], ...] = ()


@dataclass(frozen=True)
class Motion:
    """What one trial left: forces_n [T, S, 3] at t_s [T], and per step [K] what really happened.

    position_m [T, 3] of the object; per step: at_s,
    agents_n [K, 3], gripped [K] (any contact), slips and slides [K] (any, every touching element slides),
    slip_m [K] (mean travel of the touching contacts so far).
    """

    t_s: FloatArray
    forces_n: FloatArray
    position_m: FloatArray
    at_s: FloatArray
    agents_n: FloatArray
    gripped: BoolArray
    slips: BoolArray
    slides: BoolArray
    slip_m: FloatArray


class _Tape:
    """Arrays that a batch writes while it runs."""

    def __init__(self, n_steps: int, n_samples: int, contacts: int, lanes: int) -> None:
        self.forces = np.zeros((lanes, n_samples, contacts, 3))
        self.position = np.zeros((lanes, n_samples, 3))
        self.agents = np.zeros((n_steps, 3, lanes), dtype=np.float32)
        self.gripped, self.slips, self.slides = (np.zeros((n_steps, lanes), dtype=np.bool_) for _ in range(3))
        self.slip = np.zeros((n_steps, lanes), dtype=np.float32)


def run_batch(trials: Sequence[Trial], loop: Loop) -> list[Motion]:
    """Step a batch of trials to their ends; a trial's result does not depend on its batch (of two or more)."""
    spans = loop.busy or [()] * len(trials)
    grids = [grid_of(trial, loop.rate_hz, loop.step_s, more) for trial, more in zip(trials, spans, strict=True)]
    at_s, sample = _stack(grids)
    body = body_of(trials, loop.pressure)
    script = Script(trials, body)
    before_s = np.vstack([[grid.start_s for grid in grids], at_s[:-1]])
    state = at_rest(body, script.chunk(before_s[:1])[0].closure_m)
    tape = _Tape(len(at_s), max(grid.n_samples for grid in grids), *state.normal_n.shape)
    mean = _Mean(loop, *state.normal_n.shape) if loop.average_s else None
    travel = np.zeros(state.normal_n.shape)
    for start in range(0, len(at_s), CHUNK):
        inputs = script.chunk(at_s[start : start + CHUNK])
        for k, now in enumerate(inputs, start):
            dt_s = at_s[k] - before_s[k]
            step(body, state, now, dt_s, at_s[k], loop.effects)
            travel += state.slip_m_s.mean(axis=0) * dt_s
            _note(tape, k, state, travel)
            if mean is not None:
                mean.add(body, state, at_s[k], dt_s)
            ends = np.flatnonzero(sample[k] >= 0)
            if ends.size:
                _sample(tape, sample[k, ends], ends, body, state, mean)
    return [_motion(tape, loop.rate_hz, lane, grid) for lane, grid in enumerate(grids)]


def _stack(grids: Sequence[Grid]) -> tuple[FloatArray, IntArray]:
    """[K, B] times and samples; a lane that has ended goes on in steps of its last one, unheard."""
    longest = max(len(grid.at_s) for grid in grids)
    at_s, sample = np.empty((longest, len(grids))), np.full((longest, len(grids)), -1, dtype=np.int64)
    for lane, grid in enumerate(grids):
        n, last_s = len(grid.at_s), np.concatenate([[grid.start_s], grid.at_s])[-2:]
        at_s[:n, lane], sample[:n, lane] = grid.at_s, grid.sample
        at_s[n:, lane] = last_s[1] + (last_s[1] - last_s[0]) * np.arange(1, longest - n + 1)
    return at_s, sample


def _note(tape: _Tape, k: int, state: State, travel: FloatArray) -> None:
    touching = state.normal_n > 0.0
    count = touching.sum(axis=0)
    fast = state.slip_m_s > SLIDES_M_S
    tape.agents[k] = state.agents_n
    tape.gripped[k] = count > 0
    tape.slips[k] = (fast.any(axis=0) & touching).any(axis=0)
    tape.slides[k] = (fast.all(axis=0) | ~touching).all(axis=0) & (count > 0)
    tape.slip[k] = (travel * touching).sum(axis=0) / np.maximum(count, 1)


def _forces(body: Body, state: State, lanes: IntArray) -> FloatArray:
    """[S, 3, n] on the fingertips: shear x, shear y, normal; the object pulls a sensor the way it moves."""
    shear = (body.brush_n_per_m[..., lanes] * state.stretch_m[..., lanes]).sum(axis=1)
    return np.stack([shear[0], shear[1] * -body.side, state.normal_n[:, lanes]], axis=1)


class _Mean:
    """Averaging as the chip does: the mean of the forces over its conversion time before each sample."""

    def __init__(self, loop: Loop, contacts: int, lanes: int) -> None:
        self.window_s, self.period_s = loop.average_s, 1.0 / loop.rate_hz
        self.total, self.weight_s = np.zeros((contacts, 3, lanes)), np.zeros(lanes)
        self.lanes = np.arange(lanes)

    def add(self, body: Body, state: State, at_s: FloatArray, dt_s: FloatArray) -> None:
        """The part of the step that lies within the window before the next sample counts."""
        opens_s = np.ceil(at_s / self.period_s - 1e-6) * self.period_s - self.window_s
        weight_s = np.minimum(dt_s, np.maximum(at_s - opens_s, 0.0))
        lanes = np.flatnonzero(weight_s > 0.0)
        self.total[..., lanes] += _forces(body, state, lanes) * weight_s[lanes]
        self.weight_s += weight_s

    def take(self, lanes: IntArray) -> FloatArray:
        """[S, 3, n] the mean, and begin anew."""
        mean: FloatArray = self.total[..., lanes] / self.weight_s[lanes]
        self.total[..., lanes], self.weight_s[lanes] = 0.0, 0.0
        return mean


def _sample(
    tape: _Tape, rows: IntArray, lanes: IntArray, body: Body, state: State, mean: _Mean | None
) -> None:
    forces = _forces(body, state, lanes) if mean is None else mean.take(lanes)
    tape.position[lanes, rows] = state.position_m[:, lanes].T
    tape.forces[lanes, rows] = np.moveaxis(forces, 2, 0)


def _motion(tape: _Tape, rate_hz: float, lane: int, grid: Grid) -> Motion:
    n, k = grid.n_samples, len(grid.at_s)
    tape.position[lane, grid.sample[-1] + 1 : n] = tape.position[lane, grid.sample[-1]]
    return Motion(
        t_s=np.arange(n) / rate_hz,
        forces_n=tape.forces[lane, :n],
        position_m=tape.position[lane, :n],
        at_s=grid.at_s,
        agents_n=tape.agents[:k, :, lane].astype(np.float64),
        gripped=tape.gripped[:k, lane],
        slips=tape.slips[:k, lane],
        slides=tape.slides[:k, lane],
        slip_m=tape.slip[:k, lane].astype(np.float64),
    )
