"""Steps trials through the solver: forces at every sample, and the truth at every step.

A `Part` is some trials of a batch with all that a step of them needs. The open loop (motions) and
the closed one (loop/physics.py) step parts; they differ in when they do, and in what is taken out.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from copy import copy
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray, IntArray
from holdfast.simulation.effects.effect import NO_EFFECTS, Interval, PhysicsEffects
from holdfast.simulation.physics.body import Body, Inputs, State, at_rest
from holdfast.simulation.physics.solver import step
from holdfast.simulation.scenes.protocol import Trials, of_each
from holdfast.simulation.scenes.script import Script, body_of
from holdfast.simulation.scenes.script_times import Grid, grid_of

CHUNK = 64
"""Steps whose inputs are computed together."""
WORTH_LEAVING = 16
"""Ended trials are dropped when they are one in 16 or more, because dropping copies the rest."""
PASSING_S = 1e-3
"""Steps of a trial that has ended, while others go on."""
SLIDES_M_S = 2e-4
"""An element slower than this creeps about its equilibrium and does not slip."""
ONE_ELEMENT = np.ones(1)
"""Pressure of a brush that has a single element: it bears the whole normal force."""
Done = Callable[[float], None]
"""Called with how much is done."""


@dataclass(frozen=True)
class StepSettings:
    """How a batch is stepped.

    rate_hz    samples a second
    step_s     step where anything can happen
    pressure   [E] shares of the brush's elements
    effects    what takes part in every step
    average_s  the sensor reports the mean over this time before each sample; 0: its value there
    busy       more intervals with fine steps, for every trial
    """

    rate_hz: float
    step_s: float
    pressure: FloatArray = field(default_factory=lambda: ONE_ELEMENT)
    effects: PhysicsEffects = NO_EFFECTS
    average_s: float = 0.0
    busy: Sequence[Sequence[Interval]] = ()


@dataclass(frozen=True)
class TrialMotion:
    """One trial stepped: what the sensors feel at T samples, and the truth at K steps.

    t_s         [T]
    forces_n    [T, S, 3]
    position_m  [T, 3] of the object
    at_s        [K] ends of the steps
    agents_n    [K, 3] force of people and box
    gripped     [K] any contact
    slips       [K] any touching element slides
    slides      [K] every touching element slides
    slip_m      [K] mean travel of the touching contacts so far
    turned_rad  [K] angle of the object about the thumb's axis; 0 where nothing turns it
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
    turned_rad: FloatArray


STEP = np.dtype(
    [
        ("at_s", "f8"),
        ("agents_n", "f4", 3),
        ("slip_m", "f4"),
        ("turned_rad", "f4"),
        *((name, "?") for name in ("gripped", "slips", "slides", "taken")),
    ]
)
"""What a step of a trial leaves, fields of TrialMotion, in single precision to save memory; taken:
the step is one of the trial, which may skip some."""


class StepTape:
    """What every step of every trial leaves: the truth of TrialMotion.

    rows  [steps, B] of STEP
    """

    def __init__(self, steps: int, batch: int) -> None:
        self.rows = np.zeros((steps, batch), STEP)

    def write(
        self,
        k: int,
        trials: slice | IntArray,
        at_s: FloatArray,
        state: State,
        travel_m: FloatArray,
    ) -> None:
        """Step k of some trials; travel_m [S, B]: how far each contact has slipped."""
        # The events of a trial are read off these flags: they are of the solver, of no sensor.
        touching = state.normal_n > 0.0
        count = touching.sum(axis=0)
        gripped = count > 0

        # An element counts as slipping only where its contact touches.
        fast = state.slip_m_s > SLIDES_M_S
        slipping = fast.any(axis=0) & touching
        sliding = fast.all(axis=0) | ~touching
        travelled_m = (travel_m * touching).sum(axis=0)

        row = self.rows[k]
        row["at_s"][trials] = at_s
        row["taken"][trials] = True
        row["agents_n"][trials] = state.agents_n.T
        row["gripped"][trials] = gripped
        row["slips"][trials] = slipping.any(axis=0)
        # A hand without contact does not slide.
        row["slides"][trials] = sliding.all(axis=0) & gripped
        row["slip_m"][trials] = travelled_m / np.maximum(count, 1)
        row["turned_rad"][trials] = state.turned_rad

    def motion(
        self, trial: int, rate_hz: float, forces_n: FloatArray, position_m: FloatArray
    ) -> TrialMotion:
        """One trial of the tape, with its samples."""
        # The rows that the trial skipped hold nothing of it.
        rows = self.rows[:, trial]
        rows = rows[rows["taken"]]
        return TrialMotion(
            np.arange(len(forces_n)) / rate_hz,
            forces_n,
            position_m,
            at_s=rows["at_s"],
            agents_n=rows["agents_n"].astype(np.float64),
            gripped=rows["gripped"],
            slips=rows["slips"],
            slides=rows["slides"],
            slip_m=rows["slip_m"].astype(np.float64),
            turned_rad=rows["turned_rad"].astype(np.float64),
        )


def forces_of(body: Body, state: State) -> FloatArray:
    """[S, 3, B] on the fingertips: shear x, y, normal; shear points the way the object moves."""
    brush_n = body.brush_n_per_m * state.stretch_m
    shear_n = np.add.reduce(brush_n, axis=1)

    forces = np.empty((len(state.normal_n), 3, shear_n.shape[2]))
    forces[:, 0] = shear_n[0]
    # The sensors of thumb and fingers face each other, so their y axes differ in sign.
    forces[:, 1] = shear_n[1] * -body.side
    forces[:, 2] = state.normal_n
    return forces


class ForceMean:
    """The chip's averaging: the mean of the forces over its conversion time before a sample.

    total     [S, 3, B] sum of force times time since the window began, N s
    weight_s  [B] the time that is in the sum
    """

    def __init__(self, settings: StepSettings, contacts: int, batch: int) -> None:
        self.window_s = settings.average_s
        self.period_s = 1.0 / settings.rate_hz
        self.total = np.zeros((contacts, 3, batch))
        self.weight_s = np.zeros(batch)

    def add(self, body: Body, state: State, at_s: FloatArray, dt_s: FloatArray) -> None:
        """Add the part of the step that lies within the window before the next sample.

        A trial outside its window adds its forces times zero, which changes no bit and costs less
        than masking.
        """
        # The next sample; a step that ends on it counts for it, whatever the rounding.
        periods = np.ceil(at_s / self.period_s - 1e-6)
        sample_s = periods * self.period_s

        # The chip converts during the last window_s before its sample.
        window_from_s = sample_s - self.window_s
        within_s = np.maximum(at_s - window_from_s, 0.0)
        weight_s = np.minimum(dt_s, within_s)
        if weight_s.any():
            self.total += forces_of(body, state) * weight_s
            self.weight_s += weight_s

    def take(self, trials: IntArray) -> FloatArray:
        """[S, 3, n] the mean; starts the next one."""
        mean = self.total[..., trials] / self.weight_s[trials]
        self.total[..., trials] = 0.0
        self.weight_s[trials] = 0.0
        return mean


def some_trials(batched: Any, which: npt.NDArray[np.int64], n: int) -> Any:
    """A copy of what holds arrays of a batch of n trials, with some of its trials.

    Arrays whose last axis has n entries have the trials there; lists and tuples are looked into.
    """
    if isinstance(batched, np.ndarray):
        if batched.shape[-1:] != (n,):
            return batched
        # `take`, not [..., which]: the layout in memory decides in which order numpy sums.
        return np.take(batched, which, axis=-1)
    if isinstance(batched, list | tuple):
        return type(batched)([some_trials(part, which, n) for part in batched])
    if not hasattr(batched, "__dict__"):
        return batched

    part = copy(batched)
    for name, value in vars(batched).items():
        object.__setattr__(part, name, some_trials(value, which, n))

    return part


class Part:
    """Some trials of a batch, and all that a step of them needs.

    trials    their places in the batch
    body      their constants
    state     where everything is
    effects   what takes part in every step
    travel_m  [S, n] how far each contact has slipped so far
    mean      of the forces, where the chip averages
    """

    def __init__(
        self, settings: StepSettings, script: Script, start_s: FloatArray
    ) -> None:
        self.trials: slice | IntArray = slice(None)
        self.body = script.body
        self.effects = settings.effects

        # Before its first step a trial rests as its script has it then.
        opening = script.chunk(start_s[None])[0]
        self.state = at_rest(self.body, opening.closure_m)
        self.travel_m = np.zeros_like(self.state.normal_n)
        self.mean: ForceMean | None = None
        if settings.average_s:
            self.mean = ForceMean(settings, *self.travel_m.shape)

    def some(self, which: IntArray, trials: slice | IntArray) -> Part:
        """A copy with those of its trials; trials: their places in the batch."""
        part: Part = some_trials(self, which, self.travel_m.shape[1])
        part.trials = trials
        return part

    def step(
        self,
        tape: StepTape,
        row: int,
        inputs: Inputs,
        at_s: FloatArray,
        dt_s: FloatArray,
    ) -> None:
        """One step of dt_s to at_s [n], which leaves its truth in a row of the tape."""
        step(self.body, self.state, inputs, dt_s, at_s, self.effects)
        # A contact slips as the mean of its elements does.
        total_m_s = np.add.reduce(self.state.slip_m_s, axis=0)
        self.travel_m += total_m_s / len(self.state.slip_m_s) * dt_s
        tape.write(row, self.trials, at_s, self.state, self.travel_m)
        if self.mean is not None:
            self.mean.add(self.body, self.state, at_s, dt_s)

    def felt_n(self, which: IntArray) -> FloatArray:
        """[n, S, 3] what the sensors feel of some of the trials, at a sample."""
        if self.mean is not None:
            forces = self.mean.take(which)
        else:
            forces = forces_of(self.body, self.state)[..., which]
        return forces.transpose(2, 0, 1)


def motions(
    trials: Trials,
    settings: StepSettings,
    done: Done = lambda share: None,
) -> Iterator[TrialMotion]:
    """Step a batch of trials to their ends; yields one motion at a time.

    So the motions of a large batch need not all be in memory. A trial's result does not depend on
    its batch, if that has two or more. done: called now and then with the share that is stepped.
    """
    loop = _OpenLoop(trials, settings)
    n_steps = len(loop.at_s)

    # Inputs of many steps at once: a call of numpy costs as much as a small batch.
    for start in range(0, n_steps, CHUNK):
        loop.leave(start)
        loop.step_on(start, start + CHUNK)
        share = (start + CHUNK) / n_steps
        done(min(1.0, share))

    for k in range(len(trials)):
        yield loop.motion(k)


class _OpenLoop:
    """The trials of a batch that still run, all from `first` on: each on the steps of its own grid.

    grids                 the steps of each trial
    at_s, before_s        [K, B] end and start of each step
    sample                [K, B] the sample that it ends at, or -1
    steps                 [B] how many steps each trial has
    forces_n, position_m  [B, T, ..] at the samples of all trials
    tape                  the truth at every step
    """

    def __init__(self, trials: Trials, settings: StepSettings) -> None:
        self.trials = trials
        self.rate_hz = settings.rate_hz
        self.first = 0
        self.grids = []
        for k, trial in enumerate(trials):
            more = settings.busy[k] if settings.busy else ()
            grid = grid_of(trial, settings.rate_hz, settings.step_s, more)
            self.grids.append(grid)
        self.at_s, self.sample = _stack(self.grids)
        start_s = of_each(self.grids, "start_s")

        # Every trial has steps of its own, so ends and starts are arrays.
        self.before_s = np.vstack([start_s, self.at_s[:-1]])
        self.steps = np.array([len(grid.at_s) for grid in self.grids])

        self.script = Script(trials, body_of(trials, settings.pressure))
        self.part = Part(settings, self.script, start_s)

        # Forces are kept at samples, but events can happen at any step.
        samples = len(trials), max(grid.n_samples for grid in self.grids)
        self.forces_n = np.zeros((*samples, len(self.part.travel_m), 3))
        self.position_m = np.zeros((*samples, 3))
        self.tape = StepTape(*self.at_s.shape)

    def leave(self, start: int) -> None:
        """Drop ended trials from the front where that is worth the copying; at least two stay."""
        batch = len(self.trials)

        # Scene.run sorts its trials by length, so those in front end first.
        ended = self.steps[self.first :] <= start
        count = int(np.argmin([*ended, False]))

        # numpy sums a single trial in another order than many.
        count = min(count, batch - 2)
        worth = max(1, batch // WORTH_LEAVING)
        if count < worth:
            return

        self.trials = self.trials[count:]
        self.first = self.first + count
        left = np.arange(count, batch)
        self.part = self.part.some(left, slice(self.first, None))
        self.script = Script(self.trials, self.part.body, self.script.boxed)

    def step_on(self, start: int, stop: int) -> None:
        """Steps start .. stop of the running trials."""
        first = self.first
        chunk_s = self.at_s[start:stop, first:]

        for k, inputs in enumerate(self.script.chunk(chunk_s), start):
            at_s = self.at_s[k, first:]
            self.part.step(self.tape, k, inputs, at_s, at_s - self.before_s[k, first:])

            # A step that ends at a sample leaves what the sensors feel.
            samples = self.sample[k, first:]
            sampled = (samples >= 0).nonzero()[0]
            if sampled.size:
                at = first + sampled, samples[sampled]
                self.forces_n[at] = self.part.felt_n(sampled)
                self.position_m[at] = self.part.state.position_m[:, sampled].T

    def motion(self, trial: int) -> TrialMotion:
        """What became of a trial."""
        grid = self.grids[trial]
        forces_n = self.forces_n[trial, : grid.n_samples]
        position_m = self.position_m[trial, : grid.n_samples]
        last = grid.sample[-1]

        # After the last step the object is where it was, and the trial only waits for others.
        position_m[last + 1 :] = position_m[last]
        self.tape.rows["taken"][len(grid.at_s) :, trial] = False
        return self.tape.motion(trial, self.rate_hz, forces_n, position_m)


def _stack(grids: Sequence[Grid]) -> tuple[FloatArray, IntArray]:
    """[K, B] times and samples; a trial that has ended repeats its last step, without samples."""
    longest = max(len(grid.at_s) for grid in grids)
    at_s = np.empty((longest, len(grids)))
    sample = np.full((longest, len(grids)), -1, dtype=np.int64)

    for trial, grid in enumerate(grids):
        n = len(grid.at_s)
        sample[:n, trial] = grid.sample
        at_s[:n, trial] = grid.at_s
        # The times go on, so that no step has length zero.
        at_s[n:, trial] = grid.at_s[-1] + PASSING_S * np.arange(1, longest - n + 1)

    return at_s, sample
