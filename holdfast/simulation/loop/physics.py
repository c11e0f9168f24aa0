"""B hands and objects, stepped together one sample period at a time.

All trials go through the same sample period at once, because one graph answers them. A trial takes
fine steps where anything can happen (the script is busy, its grip moves, its object slides) and one
long step elsewhere, as an open loop does (script.py); with a grip that never changes the result is
that of the open loop, bit for bit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, IntArray
from holdfast.core.trial_layout import RISKY_ACTIONS
from holdfast.simulation.effects.effect import NO_EFFECTS
from holdfast.simulation.loop.drive import Actuator
from holdfast.simulation.loop.people import MISTAKEN_S, Habits, LoopScript
from holdfast.simulation.physics.body import Inputs
from holdfast.simulation.physics.solver import two_at_least
from holdfast.simulation.scenes.protocol import PlannedTrial, Trials
from holdfast.simulation.scenes.scene import Scene
from holdfast.simulation.scenes.script import body_of
from holdfast.simulation.scenes.script_times import (
    SETTLE_S,
    Times,
    grid_of,
    needs_fine_steps,
    pieces_of,
)
from holdfast.simulation.scenes.stepper import (
    Part,
    StepSettings,
    StepTape,
    TrialMotion,
    some_trials,
)

FALL_S = 1.0
"""A fall is watched at least this long: in it the object is gone, or at rest."""


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

    def some(self, which: IntArray) -> Spans:
        """Those of some trials, which may repeat."""
        return Spans(*[numbers[which] for numbers in vars(self).values()])

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
    trials: Trials,
    before: int,
    habits: Habits,
) -> Spans:
    """When the loops of some trials begin, so many samples early, and end.

    A pull or a fall goes on until its outcome is known, be it after the end of the trial.
    """
    rate_hz = scene.file.rate_hz
    spans = []
    for trial in trials:
        grid = grid_of(trial, rate_hz, scene.file.step_s)
        end = int(np.ceil(loop_end_s(trial, habits) * rate_hz))
        # Nothing is decided after the hand has opened.
        if trial.action not in RISKY_ACTIONS:
            end = min(end, int(grid.sample[-1]))

        moves = round(grid.start_s * rate_hz)
        # A loop that outlasts its trial needs sensor draws for the samples after it, too.
        count = max(grid.n_samples, end + 1)
        spans.append([max(moves - before, 0), moves, end, count])
    return Spans(*np.array(spans).T)


@dataclass(frozen=True)
class WearerWish:
    """What the wearers want of B hands in n steps of a sample period.

    ends_s      [n, B] ends of the steps
    closures_m  [S, B] at each, how far the wearer closes the fingers
    own_n       [n, B] the grip that the wearer asks for, N a side
    """

    ends_s: FloatArray
    closures_m: list[FloatArray]
    own_n: FloatArray

    def some(self, which: IntArray) -> WearerWish:
        """Those of some hands, which may repeat."""
        # `take` keeps the layout in memory, which decides in which order numpy sums.
        ends_s = np.take(self.ends_s, which, axis=1)
        closures_m = [np.take(one_m, which, axis=1) for one_m in self.closures_m]
        return WearerWish(ends_s, closures_m, np.take(self.own_n, which, axis=1))


class HandsAndObjects:
    """The physics of B trials.

    forces_n    [B, S, 3] at the last sample
    position_m  [B, 3] at the last sample
    all         every trial, as it is stepped
    busy        [periods, trials] where the script of a trial, or an effect, asks for fine steps
    kinds       [B] each hand's trial, of those
    slid        [B] whether any part of a contact slips, be it while the object still holds
    tape        the truth at every step; a trial takes only some of its rows
    columns     [B] each hand's column of the tape
    """

    def __init__(
        self,
        trials: Trials,
        settings: StepSettings,
        spans: Spans,
        actuator: Actuator,
        habits: Habits,
        lanes: int | None = None,
        columns: IntArray | None = None,
    ) -> None:
        """columns: each hand's of the tape, which has so many lanes; None: one a hand."""
        self.settings = settings
        self.spans = spans
        self.actuator = actuator
        body = body_of(trials, settings.pressure)
        self.script = LoopScript(trials, body, habits)
        batch = len(trials)

        # The hand is open and everything rests when the loop begins.
        self.all = Part(settings, self.script, spans.begins / settings.rate_hz)
        self.forces_n = np.zeros((batch, len(self.all.travel_m), 3))
        self.position_m = np.zeros((batch, 3))
        self.pieces = pieces_of(settings.rate_hz, settings.step_s)
        # Trials begin at samples of their own, so the same period is another sample in each.
        index = spans.begins + np.arange(spans.periods)[:, None]
        self.busy = np.zeros(index.shape, dtype=np.bool_)
        for k, trial in enumerate(trials):
            more = [*settings.busy[k]]
            if habits.mistake_s:
                # until the object is at rest again
                begins_s = Times.of(trial).act - MISTAKEN_S
                more.append((begins_s, begins_s + MISTAKEN_S))
            rate_hz = settings.rate_hz
            self.busy[:, k] = needs_fine_steps(trial, index[:, k], rate_hz, more)
        self.slid = np.zeros(batch, dtype=np.bool_)

        self.kinds = np.arange(batch)

        # A trial may skip rows of the tape: those of fine steps that it does not take.
        self.columns = self.kinds if columns is None else columns
        self.tape = StepTape(spans.periods * self.pieces, lanes or batch)
        self.all.trials = self.columns

    def keep(
        self, which: IntArray, columns: IntArray, actuator: Actuator, period: int
    ) -> None:
        """Go on, from a sample period, with some of the hands, which may repeat.

        columns: theirs of the tape. actuator: their drives.
        """
        # What a hand was before it became two is the past of both.
        steps = period * self.pieces
        new = columns != self.columns[which]
        if new.any():
            past = self.tape.rows[:steps, self.columns[which[new]]]
            self.tape.rows[:steps, columns[new]] = past

        self.actuator = actuator
        self.columns = columns
        self.all = self.all.some(which, columns)
        self.script = self.script.some(which, self.all.body)
        self.spans = self.spans.some(which)
        self.kinds = self.kinds[which]
        self.slid = self.slid[which]
        self.forces_n = self.forces_n[which]
        self.position_m = self.position_m[which]

    def opens(self, period: int) -> BoolArray:
        """[B] whether the wearer opens the hand at a sample, or has opened it for good."""
        at = self.spans.begins + period
        return self.script.opens(at / self.settings.rate_hz)

    def wanted(self, period: int) -> WearerWish:
        """What the wearers want in a sample period."""
        at = self.spans.begins + period
        within = (np.arange(self.pieces)[:, None] + 1) / self.pieces
        ends_s = (at + within) / self.settings.rate_hz
        closures_m = self.script.wearers_closures(ends_s)
        own_n = self.script.places_n(ends_s, closures_m)
        return WearerWish(ends_s, closures_m, own_n)

    def advance(
        self, period: int, target_n: FloatArray, wanted: WearerWish | None = None
    ) -> None:
        """One sample period of all trials; target_n [B]: of the drives.

        wanted: by the wearers in it; None: it is computed here.
        """
        wanted = self.wanted(period) if wanted is None else wanted
        at = self.spans.begins + period
        begun = at >= self.spans.moves
        moves = begun & (at < self.spans.ends)

        rate_hz = self.settings.rate_hz
        target_n = self.actuator.obeyed_n(target_n, self.opens(period))
        # An object that is merely held needs no fine steps: the solver is stable at any step.
        busy = self.busy[period, self.kinds]
        eventful = busy | self.slid | self.actuator.moving(target_n)
        fine = moves & eventful
        coarse = moves & ~fine
        if self.settings.effects != NO_EFFECTS:
            # Effects go on for the whole batch, so all of it takes the same steps.
            any_fine = bool(fine.any())
            fine = np.full_like(moves, fill_value=any_fine)
            coarse = ~fine

        # The drive moves in every piece, whether or not the physics takes it.
        pieces = self.pieces
        dt_s = 1.0 / (rate_hz * pieces)
        ends_s, closures_m = wanted.ends_s, wanted.closures_m
        for own_m, each_n in zip(closures_m, wanted.own_n, strict=True):
            place_n = self.actuator.step(target_n, dt_s, each_n)
            self.script.driven(own_m, each_n, place_n)

        # Without fine steps only the inputs at the end of the period are needed.
        first = 0 if fine.any() else pieces - 1
        inputs = self.script.chunk(ends_s[first:], closures_m[first:])

        # Every period has `pieces` rows of the tape, whether or not a trial takes them all.
        row = period * pieces
        times_s = np.vstack([at / rate_hz, ends_s])
        self._step(fine, inputs, times_s, row)

        # The one long step takes the inputs of the period's end, as an open loop's does.
        self._step(coarse, inputs[-1:], times_s[[0, -1]], row + pieces - 1)

    def _step(
        self, which: BoolArray, inputs: list[Inputs], times_s: FloatArray, row: int
    ) -> None:
        """Step some trials [B] to a sample, from each of times_s [n + 1, B] to the next."""
        batch = len(which)
        trials = two_at_least(np.flatnonzero(which))
        if not trials.size:
            return

        # All trials need no copies.
        part = self.all
        if not which.all():
            part = self.all.some(trials, self.columns[trials])
        for k, given in enumerate(inputs):
            some = given if part is self.all else some_trials(given, trials, batch)
            at_s = times_s[k + 1, trials]
            dt_s = at_s - times_s[k, trials]
            part.step(self.tape, row + k, some, at_s, dt_s)

        state = part.state
        self.forces_n[trials] = part.felt_n(np.arange(len(trials)))
        self.position_m[trials] = state.position_m.T
        # An object that slides takes fine steps in the next period too.
        last = row + len(inputs) - 1
        self.slid[trials] = self.tape.rows["slips"][last, self.columns[trials]]
        if part is not self.all:
            self.all.travel_m[:, trials] = part.travel_m
            for name, array in vars(self.all.state).items():
                array[..., trials] = vars(state)[name]

    def motion(self, trial: int, *samples: FloatArray) -> TrialMotion:
        """What became of a trial, as an open loop gives it; samples: forces and positions [T, ..].

        trial: its column of the tape.
        Without samples it is to be read off its steps alone.
        """
        samples = samples or (np.zeros((2, 1, 3)), np.zeros((2, 3)))
        return self.tape.motion(trial, self.settings.rate_hz, *samples)
