"""Steps batches of trials through the core: forces at every sample, and the truth at every step."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.body import Body, State, at_rest
from holdfast.simulation.core import step
from holdfast.simulation.effect import NO_EFFECTS, PhysicsEffects, without_lanes
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.script import Grid, Interval, Script, body_of, grid_of

CHUNK = 64
WORTH_LEAVING = 16
"""Ended lanes are dropped when they are one in 16 or more, because dropping copies the rest."""
SLIDES_M_S = 2e-4
"""An element slower than this creeps about its equilibrium and does not slip."""
ONE_ELEMENT = np.ones(1)
IntArray = npt.NDArray[np.int64]
Done = Callable[[float], None]
"""Called with how much is done."""


@dataclass(frozen=True)
class StepSettings:
    """How a batch is stepped.

    step_s: step where anything can happen. pressure: [E] shares of the brush. average_s: the sensor
    reports the mean over this time before each sample; 0: the value at the sample. busy: more
    intervals with fine steps, for every lane.
    """

    rate_hz: float
    step_s: float
    pressure: FloatArray = field(default_factory=lambda: ONE_ELEMENT)
    effects: PhysicsEffects = NO_EFFECTS
    average_s: float = 0.0
    busy: tuple[tuple[Interval, ...], ...] = ()


@dataclass(frozen=True)
class TrialMotion:
    """One trial stepped: forces_n [T, S, 3] and position_m [T, 3] at t_s [T], the truth at steps.

    At each of K steps: at_s; agents_n [K, 3] force of people and box; gripped (any contact);
    slips, slides (any, every touching element slides); slip_m (mean travel of the touching
    contacts so far).
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
    """Arrays that a batch writes while it runs; samples of all lanes lie end to end."""

    def __init__(self, grids: Sequence[Grid], contacts: int) -> None:
        lanes, n_steps = len(grids), max(len(grid.at_s) for grid in grids)
        self.starts = np.cumsum([0, *(grid.n_samples for grid in grids)])
        self.forces = np.zeros((self.starts[-1], contacts, 3))
        self.position = np.zeros((self.starts[-1], 3))
        self.agents = np.zeros((n_steps, 3, lanes), dtype=np.float32)
        self.gripped, self.slips, self.slides = (
            np.zeros((n_steps, lanes), dtype=np.bool_) for _ in range(3)
        )
        self.slip = np.zeros((n_steps, lanes), dtype=np.float32)


def motions(
    trials: Sequence[PlannedTrial], loop: StepSettings, done: Done = lambda share: None
) -> Iterator[TrialMotion]:
    """Step a batch of trials to their ends; yields one motion at a time.

    So the motions of a large batch need not all be in memory. A trial's result does not depend on
    its batch, if that has two or more. done: called now and then with the share that is stepped.
    """
    spans = loop.busy or [()] * len(trials)
    grids = [
        grid_of(trial, loop.rate_hz, loop.step_s, more)
        for trial, more in zip(trials, spans, strict=True)
    ]
    at_s, sample = _stack(grids)
    before_s = np.vstack([[grid.start_s for grid in grids], at_s[:-1]])
    lasts = np.array([len(grid.at_s) for grid in grids])
    lanes = _Lanes(trials, loop, before_s[0])
    tape = _Tape(grids, len(lanes.state.normal_n))
    for start in range(0, len(at_s), CHUNK):
        lanes.leave(_ended(lasts[lanes.first :] <= start))
        steps = slice(start, start + CHUNK)
        _step_on(
            lanes,
            tape,
            start,
            at_s[steps, lanes.first :],
            before_s[steps, lanes.first :],
            sample[steps],
        )
        done(min(1.0, (start + CHUNK) / len(at_s)))
    for lane, grid in enumerate(grids):
        yield _motion(tape, loop.rate_hz, lane, grid)


class _Lanes:
    """The trials of a batch that still run, all from `first` on, with everything they need."""

    def __init__(
        self, trials: Sequence[PlannedTrial], loop: StepSettings, start_s: FloatArray
    ) -> None:
        self.trials, self.loop, self.effects, self.first = trials, loop, loop.effects, 0
        self.body = body_of(trials, loop.pressure)
        self.script = Script(trials, self.body)
        self.state = at_rest(self.body, self.script.chunk(start_s[None])[0].closure_m)
        shape = self.state.normal_n.shape
        self.mean = _Mean(loop, *shape) if loop.average_s else None
        self.travel_m = np.zeros(shape)

    def leave(self, count: int) -> None:
        """Drop the first `count` lanes where that is worth the copying; at least two stay."""
        count = min(count, len(self.trials) - 2)
        if count < max(1, len(self.trials) // WORTH_LEAVING):
            return
        lanes = len(self.trials)
        self.trials, self.first = self.trials[count:], self.first + count
        self.body = body_of(self.trials, self.loop.pressure)
        self.script = Script(self.trials, self.body, self.script.boxed)
        self.state = without_lanes(self.state, count, lanes)
        self.effects = self.effects.without_lanes(count, lanes)
        self.mean = (
            None if self.mean is None else without_lanes(self.mean, count, lanes)
        )
        self.travel_m = self.travel_m[:, count:].copy()


def _ended(flags: BoolArray) -> int:
    """Number of lanes at the front that have all ended."""
    return len(flags) if flags.all() else int(np.argmin(flags))


def _step_on(
    lanes: _Lanes,
    tape: _Tape,
    start: int,
    at_s: FloatArray,
    before_s: FloatArray,
    sample: IntArray,
) -> None:
    """A chunk of steps; at_s, before_s [n, B] of the running lanes, sample [n, all lanes]."""
    state, mean, travel = lanes.state, lanes.mean, lanes.travel_m
    for k, now in enumerate(lanes.script.chunk(at_s)):
        dt_s = at_s[k] - before_s[k]
        step(lanes.body, state, now, dt_s, at_s[k], lanes.effects)
        travel += np.add.reduce(state.slip_m_s, axis=0) / len(state.slip_m_s) * dt_s
        _note(tape, start + k, lanes.first, state, travel)
        if mean is not None:
            mean.add(lanes.body, state, at_s[k], dt_s)
        ends = (sample[k, lanes.first :] >= 0).nonzero()[0]
        if ends.size:
            rows = tape.starts[lanes.first + ends] + sample[k, lanes.first + ends]
            _sample(tape, rows, ends, lanes.body, state, mean)


def _stack(grids: Sequence[Grid]) -> tuple[FloatArray, IntArray]:
    """[K, B] times and samples; a lane that has ended repeats its last step, without samples."""
    longest = max(len(grid.at_s) for grid in grids)
    at_s, sample = (
        np.empty((longest, len(grids))),
        np.full((longest, len(grids)), -1, dtype=np.int64),
    )
    for lane, grid in enumerate(grids):
        n, last_s = len(grid.at_s), np.concatenate([[grid.start_s], grid.at_s])[-2:]
        at_s[:n, lane], sample[:n, lane] = grid.at_s, grid.sample
        at_s[n:, lane] = last_s[1] + (last_s[1] - last_s[0]) * np.arange(
            1, longest - n + 1
        )
    return at_s, sample


def contact_marks(
    state: State, travel_m: FloatArray
) -> tuple[BoolArray, BoolArray, BoolArray, FloatArray]:
    """(gripped, slips, slides, slip in m), [B] each, after a step; travel_m [S, B]."""
    touching = state.normal_n > 0.0
    count = touching.sum(axis=0)
    fast = state.slip_m_s > SLIDES_M_S
    slips = np.asarray((fast.any(axis=0) & touching).any(axis=0))
    slides = np.asarray((fast.all(axis=0) | ~touching).all(axis=0) & (count > 0))
    return (
        count > 0,
        slips,
        slides,
        (travel_m * touching).sum(axis=0) / np.maximum(count, 1),
    )


def _note(tape: _Tape, k: int, first: int, state: State, travel: FloatArray) -> None:
    tape.agents[k, :, first:] = state.agents_n
    marks = contact_marks(state, travel)
    tape.gripped[k, first:], tape.slips[k, first:] = marks[:2]
    tape.slides[k, first:], tape.slip[k, first:] = marks[2:]


def forces_of(body: Body, state: State) -> FloatArray:
    """[S, 3, B] on the fingertips: shear x, y, normal; shear points the way the object moves."""
    shear = np.add.reduce(body.brush_n_per_m * state.stretch_m, axis=1)
    forces = np.empty((len(state.normal_n), 3, shear.shape[2]))
    forces[:, 0], forces[:, 1], forces[:, 2] = (
        shear[0],
        shear[1] * -body.side,
        state.normal_n,
    )
    return forces


def mean_weight_s(
    at_s: FloatArray, dt_s: FloatArray, period_s: float, window_s: float
) -> FloatArray:
    """[B] how much of a step of dt_s that ends at at_s lies in the window before a sample."""
    opens_s = np.ceil(at_s / period_s - 1e-6) * period_s - window_s
    weight_s: FloatArray = np.minimum(dt_s, np.maximum(at_s - opens_s, 0.0))
    return weight_s


class _Mean:
    """The chip's averaging: the mean of the forces over its conversion time before a sample."""

    def __init__(self, loop: StepSettings, contacts: int, lanes: int) -> None:
        self.window_s, self.period_s = loop.average_s, 1.0 / loop.rate_hz
        self.total, self.weight_s = np.zeros((contacts, 3, lanes)), np.zeros(lanes)

    def add(self, body: Body, state: State, at_s: FloatArray, dt_s: FloatArray) -> None:
        """Add the part of the step that lies within the window before the next sample.

        A lane outside its window adds its forces times zero, which changes no bit and costs less
        than masking.
        """
        weight_s = mean_weight_s(at_s, dt_s, self.period_s, self.window_s)
        if not weight_s.any():
            return
        self.total += forces_of(body, state) * weight_s
        self.weight_s += weight_s

    def take(self, lanes: IntArray) -> FloatArray:
        """[S, 3, n] the mean; starts the next one."""
        mean: FloatArray = self.total[..., lanes] / self.weight_s[lanes]
        self.total[..., lanes], self.weight_s[lanes] = 0.0, 0.0
        return mean


def _sample(
    tape: _Tape,
    rows: IntArray,
    lanes: IntArray,
    body: Body,
    state: State,
    mean: _Mean | None,
) -> None:
    forces = forces_of(body, state)[..., lanes] if mean is None else mean.take(lanes)
    tape.position[rows] = state.position_m[:, lanes].T
    tape.forces[rows] = forces.transpose(2, 0, 1)


def _motion(tape: _Tape, rate_hz: float, lane: int, grid: Grid) -> TrialMotion:
    n, k = grid.n_samples, len(grid.at_s)
    rows = slice(tape.starts[lane], tape.starts[lane + 1])
    position = tape.position[rows]
    position[grid.sample[-1] + 1 :] = position[grid.sample[-1]]
    return TrialMotion(
        t_s=np.arange(n) / rate_hz,
        forces_n=tape.forces[rows],
        position_m=position,
        at_s=grid.at_s,
        agents_n=tape.agents[:k, :, lane].astype(np.float64),
        gripped=tape.gripped[:k, lane],
        slips=tape.slips[:k, lane],
        slides=tape.slides[:k, lane],
        slip_m=tape.slip[:k, lane].astype(np.float64),
    )
