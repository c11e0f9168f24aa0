"""B hands and objects, stepped together one sample period at a time.

All trials go through the same sample period at once, because one graph answers them. A trial takes
fine steps where anything can happen (the script is busy, its grip moves, its object slides) and one
long step elsewhere, as an open loop does (script.py); with a grip that never changes the result is
that of the open loop, bit for bit.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, TypeVar

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.simulation.body import (
    Body,
    Changes,
    Floor,
    Inputs,
    Pull,
    State,
    at_rest,
)
from holdfast.simulation.core import step, two_at_least
from holdfast.simulation.drive import Actuator
from holdfast.simulation.effect import NO_EFFECTS
from holdfast.simulation.loop_people import Habits, LoopScript
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.run import (
    SLIDES_M_S,
    ForceMean,
    StepSettings,
    StepTape,
    TrialMotion,
    forces_of,
    travel_of,
)
from holdfast.simulation.scene import Scene
from holdfast.simulation.script import body_of
from holdfast.simulation.script_times import (
    SETTLE_S,
    Times,
    busy,
    grid_of,
    pieces_of,
)

IntArray = npt.NDArray[np.int64]
FALL_S = 1.0
"""A fall is watched at least this long: in it the object is gone, or at rest."""
BODIES_KEPT = 8
"""Parts of the body that are kept: the trials with fine steps change little between periods."""


@dataclass(frozen=True)
class Spans:
    """Sample numbers of B trials, [B] each.

    begins  of the loop, a while before the hand closes, so that the model has settled
    moves   of the physics
    ends    of both
    counts  of the whole trial
    """

    begins: IntArray
    moves: IntArray
    ends: IntArray
    counts: IntArray

    @property
    def periods(self) -> int:
        """Sample periods until the last trial has ended."""
        return int((self.ends - self.begins).max())


def loop_end_s(trial: PlannedTrial, habits: Habits) -> float:
    """When nothing more is decided: the person has given up, or the hand is open."""
    times = Times.of(trial)
    if trial.action == "pull":
        gone_s = times.act + habits.pull_gives_up_s + habits.lets_go_s
        return gone_s + SETTLE_S
    if trial.action == "fall":
        return times.act + max(trial.drawn["watch_s"], FALL_S)
    return times.open + trial.drawn["opening_s"] + SETTLE_S


def spans_of(
    scene: Scene,
    trials: Sequence[PlannedTrial],
    before: int,
    habits: Habits,
) -> Spans:
    """When the loops of some trials begin, so many samples early, and end.

    A pull or a fall goes on until its outcome is known, be it after the end of the trial.
    """
    rate_hz = scene.file.rate_hz
    moves = []
    ends = []
    counts = []

    for trial in trials:
        grid = grid_of(trial, rate_hz, scene.file.step_s)
        whole = int(grid.sample[-1])
        end_s = loop_end_s(trial, habits)
        end = int(np.ceil(end_s * rate_hz))

        # Nothing is decided after the hand has opened.
        if trial.action not in RISKY_ACTIONS:
            end = min(end, whole)

        # A loop that outlasts its trial needs sensor draws for the samples after it, too.
        count = max(grid.n_samples, end + 1)

        moves.append(round(grid.start_s * rate_hz))
        ends.append(end)
        counts.append(count)

    first_moves = np.array(moves)
    begins = np.maximum(first_moves - before, 0)
    return Spans(begins, first_moves, np.array(ends), np.array(counts))


class HandsAndObjects:
    """The physics of B trials.

    forces_n    [B, S, 3] at the last sample
    position_m  [B, 3] at the last sample
    travel_m    [S, B] how far each contact has slipped so far
    slid        [B] whether the object slid in the last period
    tape        the truth at every step; a trial takes only some of its rows
    taken       [steps, B] which rows those are
    at_s        [steps, B] ends of the steps that were taken
    """

    def __init__(
        self,
        trials: Sequence[PlannedTrial],
        settings: StepSettings,
        spans: Spans,
        actuator: Actuator,
        habits: Habits,
    ) -> None:
        self.settings = settings
        self.spans = spans
        self.actuator = actuator
        self.body = body_of(trials, settings.pressure)
        self.script = LoopScript(trials, self.body, habits)
        batch = len(trials)

        # The hand is open and everything rests when the loop begins.
        start_s = spans.begins / settings.rate_hz
        opening = self.script.chunk(start_s[None])[0]
        self.state = at_rest(self.body, opening.closure_m)
        self.travel_m = np.zeros_like(self.state.normal_n)
        contacts = len(self.state.normal_n)
        self.forces_n = np.zeros((batch, contacts, 3))
        self.position_m = np.zeros((batch, 3))
        self.pieces = pieces_of(settings.rate_hz, settings.step_s)
        self.busy = _busy(trials, settings, spans)
        self.slid = np.zeros(batch, dtype=np.bool_)

        # A trial may skip rows of the tape: those of fine steps that it does not take.
        self.tape = StepTape(spans.periods * self.pieces, batch)
        shape = self.tape.gripped.shape
        self.taken = np.zeros(shape, dtype=np.bool_)
        self.at_s = np.zeros(shape)
        self._bodies: dict[bytes, Body] = {}

    def slips(self) -> BoolArray:
        """[B] whether any part of a contact slips, be it while the object still holds."""
        fast = (self.state.slip_m_s > SLIDES_M_S).any(axis=0)
        touching = self.state.normal_n > 0.0
        slipping: BoolArray = np.any(fast & touching, axis=0)
        return slipping

    def advance(self, period: int, target_n: FloatArray) -> None:
        """One sample period of all trials; target_n [B]: of the drives."""
        at = self.spans.begins + period
        begun = at >= self.spans.moves
        moves = begun & (at < self.spans.ends)

        # An object that is merely held needs no fine steps: the core is stable at any step.
        eventful = self.busy[period] | self.slid | self.actuator.moving(target_n)
        fine = moves & eventful
        coarse = moves & ~fine
        if self.settings.effects != NO_EFFECTS:
            # Effects hold arrays of the whole batch, so all of it takes the same steps.
            any_fine = bool(fine.any())
            fine = np.full_like(moves, fill_value=any_fine)
            coarse = ~fine

        fine_trials = np.flatnonzero(fine)
        coarse_trials = np.flatnonzero(coarse)
        self._step_all(period, at, fine_trials, coarse_trials, target_n)

    def _step_all(
        self,
        period: int,
        at: IntArray,
        fine: IntArray,
        coarse: IntArray,
        target_n: FloatArray,
    ) -> None:
        """Move the drives, then step the trials with fine steps and those with one long step."""
        rate_hz = self.settings.rate_hz
        pieces = self.pieces
        dt_s = 1.0 / (rate_hz * pieces)

        within = (np.arange(pieces)[:, None] + 1) / pieces
        ends_s = (at + within) / rate_hz

        # The drive moves in every piece, whether or not the physics takes it.
        own_n = self.script.own_place_n(ends_s)
        places_n = [self.actuator.step(target_n, dt_s, each_n) for each_n in own_n]

        # Without fine steps only the inputs at the end of the period are needed.
        first = 0 if fine.size else pieces - 1
        self.script.own_n = own_n[first:]
        self.script.place_n = np.stack(places_n[first:])
        fine_part = _Part(self, fine)
        coarse_part = _Part(self, coarse)

        start_s = np.asarray(at / rate_hz, dtype=np.float64)
        before_s = start_s
        for k, inputs in enumerate(self.script.chunk(ends_s[first:]), first):
            end_s = ends_s[k]
            # Every period has `pieces` rows of the tape, whether or not a trial takes them all.
            row = period * pieces + k
            fine_part.step(inputs, end_s, end_s - before_s, row)
            before_s = end_s

        # The one long step takes the inputs of the period's end, as an open loop's does.
        last_s = ends_s[-1]
        last_row = (period + 1) * pieces - 1
        coarse_part.step(inputs, last_s, last_s - start_s, last_row)
        fine_part.finish()
        coarse_part.finish()

    def body_part(self, trials: IntArray) -> Body:
        """The body of some trials; kept, because the same trials come again and again."""
        key = trials.tobytes()
        if key not in self._bodies:
            if len(self._bodies) > BODIES_KEPT:
                self._bodies.clear()
            self._bodies[key] = _some(self.body, trials, len(self.position_m))
        return self._bodies[key]

    def motion(
        self, trial: int, forces_n: FloatArray, position_m: FloatArray
    ) -> TrialMotion:
        """What became of a trial, as an open loop gives it; forces and positions [T, ..]."""
        taken = self.taken[:, trial]
        # The rows that the trial skipped hold nothing of it.
        at_s = self.at_s[taken, trial]
        t_s = np.arange(len(forces_n)) / self.settings.rate_hz
        return self.tape.motion(trial, taken, at_s, t_s, forces_n, position_m)


class _Part:
    """Some trials during one sample period: taken out, stepped, put back.

    trials    their places in the batch; a single one twice, as numpy sums one in another order
    all       whether they are the whole batch, which needs no copies
    body      of these trials
    state     of these trials
    travel_m  [S, n] how far each contact has slipped so far
    mean      of the forces, where the chip averages
    """

    def __init__(self, whole: HandsAndObjects, trials: IntArray) -> None:
        self.whole = whole
        self.count = len(trials)
        self.trials = two_at_least(trials)
        if not self.count:
            return

        batch = len(whole.position_m)
        self.all = self.count == batch
        self.body = whole.body
        self.state = whole.state
        if not self.all:
            self.body = whole.body_part(self.trials)
            self.state = _some(whole.state, self.trials, batch)

        # copies: the parts are put back when the period is over
        self.travel_m = np.take(whole.travel_m, self.trials, axis=-1)
        contacts, size = self.travel_m.shape
        self.mean = ForceMean(whole.settings, contacts, size)

    def step(
        self, inputs: Inputs, at_s: FloatArray, dt_s: FloatArray, row: int
    ) -> None:
        """One step of these trials; inputs, at_s, dt_s: of all trials."""
        if not self.count:
            return

        whole = self.whole
        trials = self.trials

        # Effects are for the whole batch; advance() makes sure that it goes together.
        effects = whole.settings.effects
        if not self.all:
            inputs = _some_inputs(inputs, trials, len(at_s))
            effects = NO_EFFECTS

        at_s = at_s[trials]
        dt_s = dt_s[trials]
        step(self.body, self.state, inputs, dt_s, at_s, effects)
        self.travel_m += travel_of(self.state, dt_s)
        whole.taken[row, trials] = True
        whole.at_s[row, trials] = at_s
        whole.tape.write(row, trials, self.state, self.travel_m)
        if whole.settings.average_s:
            self.mean.add(self.body, self.state, at_s, dt_s)

    def finish(self) -> None:
        """Put the trials back, and the forces at the sample."""
        if not self.count:
            return

        whole = self.whole
        trials = self.trials
        state = self.state
        if whole.settings.average_s:
            forces = self.mean.take(np.arange(len(trials)))
        else:
            forces = forces_of(self.body, state)

        whole.forces_n[trials] = np.moveaxis(forces, 2, 0)
        whole.position_m[trials] = state.position_m.T
        whole.travel_m[:, trials] = self.travel_m

        # An object that slides takes fine steps in the next period too.
        fast = (state.slip_m_s > SLIDES_M_S).any(axis=0)
        touching = state.normal_n > 0.0
        whole.slid[trials] = (fast & touching).any(axis=0)
        if not self.all:
            values = vars(state)
            for name, array in vars(whole.state).items():
                # An object that nothing turns has no angle.
                if array is not None:
                    array[..., trials] = values[name]


Part = TypeVar("Part", Body, State, Floor, Pull, Changes)


def _some(whole: Part, trials: IntArray, batch: int) -> Part:
    """What is stepped of some trials; what is the same for the whole batch stays."""
    taken: dict[str, Any] = {}
    for name, value in vars(whole).items():
        if isinstance(value, np.ndarray) and value.ndim and value.shape[-1] == batch:
            # `take`, not [..., trials]: the layout in memory decides in which order numpy sums.
            taken[name] = np.take(value, trials, axis=-1)
    return replace(whole, **taken)


def _some_inputs(inputs: Inputs, trials: IntArray, batch: int) -> Inputs:
    """The inputs of some trials of a batch."""
    people = tuple(_some(pull, trials, batch) for pull in inputs.people)
    floor = None if inputs.floor is None else _some(inputs.floor, trials, batch)
    closure_m = np.take(inputs.closure_m, trials, axis=-1)
    changes = None if inputs.changes is None else _some(inputs.changes, trials, batch)
    return Inputs(closure_m, people, floor, changes)


def _busy(
    trials: Sequence[PlannedTrial], settings: StepSettings, spans: Spans
) -> BoolArray:
    """[periods, B] where the script of a trial, or an effect, wants fine steps."""
    periods = np.arange(spans.periods)[:, None]

    # Trials begin at samples of their own, so the same period is another sample in each.
    index = spans.begins + periods
    from_s = index / settings.rate_hz
    until_s = from_s + 1.0 / settings.rate_hz
    is_busy = np.zeros(index.shape, dtype=np.bool_)

    for k, trial in enumerate(trials):
        more = settings.busy[k] if settings.busy else ()
        for start_s, end_s in [*busy(trial), *more]:
            touches = (until_s[:, k] > start_s) & (from_s[:, k] < end_s)
            is_busy[:, k] |= touches

    return is_busy
