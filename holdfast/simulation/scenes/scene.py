"""A scene file compiled: its trials and effects, and each trial simulated to what sensors report.

Only the effects that the scene file names are in the lists below; no other is called, drawn or
kept.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.actions import action_named
from holdfast.simulation.effects.effect import (
    Drawn,
    Effect,
    EffectBatch,
    Interval,
    PhysicsEffects,
    Reported,
    Signal,
    effect_named,
    step_settings,
    stream,
)
from holdfast.simulation.physics.objects import HOLD, NO_OBJECT, read_of, sensed_of
from holdfast.simulation.scenes.protocol import (
    PlannedTrial,
    Trials,
    TrialsRow,
    draw_trial,
)
from holdfast.simulation.scenes.scene_file import SceneFile
from holdfast.simulation.scenes.script_times import grid_of
from holdfast.simulation.scenes.stepper import Done, StepSettings, TrialMotion, motions
from holdfast.simulation.scenes.truth import Truth, truth_of

BATCH = 1000
"""About this many trials are stepped together: fewer waste time on calls, more on memory."""


@dataclass(frozen=True)
class SimulatedTrial:
    """One trial simulated: what the sensors report, the truth, and the effects' draws.

    trial    as it was planned
    signal   what the sensors report
    motion   forces and positions, before any sensor
    truth    events and phases
    effects  effect name -> what was drawn for it
    hand_m   [T, 3] position of the hand, zero where no effect moves it
    """

    trial: PlannedTrial
    signal: Signal
    motion: TrialMotion
    truth: Truth
    effects: dict[str, Drawn]
    hand_m: FloatArray


class Scene:
    """A scene file, ready to simulate any of its trials from one seed.

    file             as it was read
    seed             of all random streams
    settings         how the solver steps
    sensor_effects   name -> effect, in the order in which they act
    physics_effects  name -> effect, those that take part in every step
    """

    def __init__(self, file: SceneFile, seed: int) -> None:
        self.file = file
        self.seed = seed

        # An effect that only sets how the solver steps is called once, by step_settings.
        self.sensor_effects: dict[str, Effect] = {}
        self.physics_effects: dict[str, Effect] = {}
        for name in file.effects:
            effect = effect_named(name)
            if effect.stage == "sensor":
                self.sensor_effects[name] = effect
            elif effect.stage == "physics" and not effect.sets:
                self.physics_effects[name] = effect

        more = step_settings(file.effects)
        self.settings = StepSettings(file.rate_hz, file.step_s, **more)

    def trials(self, total: int | None = None) -> list[PlannedTrial]:
        """The scene's trials; with a total, that many in the proportions of the file's counts."""
        cells: list[tuple[TrialsRow, str | None]] = []
        for row in self.file.rows:
            cells += [(row, name) for name in row.objects or (None,)]

        counts = [row.count for row, _ in cells]
        if total is not None:
            counts = apportion(total, counts)

        trials = []
        for cell, (row, name) in enumerate(cells):
            for repetition in range(counts[cell]):
                # Numbered across cells first, so that a smaller set is a part of a larger one.
                number = repetition * len(cells) + cell
                trials.append(self.trial(row, name, number))

        return trials

    def trial(self, row: TrialsRow, name: str | None, number: int) -> PlannedTrial:
        """One trial; its number picks its random streams."""
        objects = self.file.objects
        held = NO_OBJECT
        if name or row.action == "nothing":
            held = objects[name or next(iter(objects))]
        trial = draw_trial(number, held, row, self.seed, self.file.hand)
        if HOLD.keys().isdisjoint(row.values) or not trial.holds_object:
            return trial

        # Loaded only for a row that names one of its keys, with a random stream of its own.
        from holdfast.simulation.scenes.holds import in_hold

        rng = stream(self.seed, number, "hold")
        peak_m_s2 = lever_m = 0.0
        for effect_name, effect in self.physics_effects.items():
            made: Any = effect.make
            drawn = self.draw(effect_name, number)
            peak_m_s2 += made.peak_m_s2(drawn)
            lever_m += made.lever_m(drawn)
        return in_hold(trial, row.values, rng, peak_m_s2, lever_m)

    def run(
        self, trials: Trials, done: Done = lambda trials: None
    ) -> Iterator[SimulatedTrial]:
        """Simulate trials, those of similar length together; yields them as they are finished.

        done: called now and then with the number of trials stepped so far.
        """

        # Trials of similar length together: a batch lasts as long as its longest trial.
        def length(trial: PlannedTrial) -> tuple[int, int]:
            grid = grid_of(trial, self.file.rate_hz, self.file.step_s)
            return len(grid.at_s), trial.number

        order = sorted(trials, key=length)

        # Batches of equal size, rounded up.
        batches = max(1, round(len(order) / BATCH))
        size = -(-len(order) // batches)
        for start in range(0, len(order), size):
            batch = order[start : start + size]

            def report(share: float, start: int = start, n: int = len(batch)) -> None:
                done(start + share * n)

            yield from self._simulated(batch, report)

    def run_together(self, trials: Trials) -> list[SimulatedTrial]:
        """One batch, in the order given."""
        return list(self._simulated(trials))

    def _simulated(
        self, trials: Trials, done: Done = lambda share: None
    ) -> Iterator[SimulatedTrial]:
        """Simulate one batch; yields its trials in their order."""
        if len(trials) == 1:  # numpy would sum a single trial in another order
            yield next(self._simulated([trials[0], trials[0]], done))
            return

        # Effects of the physics are built once for the batch, those of the sensor trial by trial.
        settings = self.step_settings_of(trials)
        moved = motions(trials, settings, done)
        # Only an effect with a path moves the hand; a tremor gives an acceleration alone.
        shakes = settings.effects.shakes
        movers = [shake for shake in shakes if hasattr(shake, "motion_m")]

        for k, (trial, motion) in enumerate(zip(trials, moved, strict=True)):
            touched = action_named(trial.action).touched
            if touched is not None:
                motion = touched(trial, motion, self.settings.average_s)
            hand_m = np.zeros_like(motion.position_m)
            if movers:
                hand_m = movers[0].motion_m(motion.t_s, k)
            signal, sensed = self.sense(trial, motion.t_s, motion.forces_n)
            effects = {
                name: self.draw(name, trial.number) for name in self.physics_effects
            }
            truth = truth_of(trial, motion)
            yield SimulatedTrial(trial, signal, motion, truth, effects | sensed, hand_m)

    def step_settings_of(self, trials: Trials) -> StepSettings:
        """How a batch of these trials is stepped: its effects, and when these need fine steps."""
        of_kind: dict[str, tuple[Any, ...]] = {}
        busy: list[list[Interval]] = [[] for _ in trials]
        for name, effect in self.physics_effects.items():
            drawn = [self.draw(name, trial.number) for trial in trials]
            rngs = [self.rng(name, trial) for trial in trials]
            made = effect.make(EffectBatch(drawn, trials, rngs))
            of_kind[made.kind] = (*of_kind.get(made.kind, ()), made)
            for k, intervals in enumerate(busy):
                intervals += made.busy_s(k)

        effects = PhysicsEffects(**of_kind)
        return replace(self.settings, effects=effects, busy=busy)

    def join(
        self, trials: Sequence[SimulatedTrial]
    ) -> tuple[Signal, list[float], dict[str, Drawn]]:
        """(signal of trials end to end, start of each in s, the sensors' draws).

        Trials are one sample apart. All pass through the sensors of the first: one hand makes many
        grasps.
        """
        if len(trials) == 1:
            return trials[0].signal, [0.0], {}

        starts_s = [0.0]
        for simulated in trials:
            last_s = float(simulated.motion.t_s[-1])
            starts_s.append(starts_s[-1] + last_s + 1.0 / self.file.rate_hz)
        starts_s.pop()

        t_s = shifted_s(trials, starts_s)
        forces_n = np.concatenate([simulated.motion.forces_n for simulated in trials])
        signal, drawn = self.sense(trials[0].trial, t_s, forces_n)
        return signal, starts_s, drawn

    def sense(
        self, trial: PlannedTrial, t_s: FloatArray, forces_n: FloatArray
    ) -> tuple[Signal, dict[str, Drawn]]:
        """(signal in the scene's unit, draws) of forces [T, S, 3] at t_s [T] on the sensors."""
        forces_n = sensed_of(trial.hand, forces_n)
        all_valid = np.ones(forces_n.shape[:2], dtype=np.bool_)
        signal = Signal(forces_n, all_valid, t_s=t_s)

        # The order in which effects act is that of EFFECT_MODULES.
        drawn = {}
        for name, effect in self.sensor_effects.items():
            if effect.in_scene_unit:
                signal = self.in_unit(signal)
            drawn[name] = self.draw(name, trial.number)
            rng = self.rng(name, trial)
            signal = effect.sense(signal, drawn[name], rng)

        return read_of(trial.hand, self.in_unit(signal)), drawn

    def in_unit(self, rows: Reported) -> Reported:
        """Rows in the scene's unit."""
        if rows.unit != "uT" or self.file.unit != "N":
            return rows
        # Only scenes with a magnet need its calibration.
        from holdfast.simulation.effects.magnet import calibrate

        return calibrate(rows)

    def draw(self, name: str, number: int) -> Drawn:
        """Parameters of an effect in the trial of that number."""
        rng = stream(self.seed, number, f"{name} parameters")
        return effect_named(name).draw(self.file.effects[name], rng)

    def rng(self, name: str, trial: PlannedTrial) -> np.random.Generator:
        """The random stream of an effect in a trial."""
        return stream(self.seed, trial.number, name)


def shifted_s(
    trials: Sequence[SimulatedTrial], starts_s: Sequence[float]
) -> FloatArray:
    """[T] times of the samples of trials end to end, from the start of each in s."""
    pairs = zip(trials, starts_s, strict=True)
    return np.concatenate([one.motion.t_s + start_s for one, start_s in pairs])


def apportion(total: int, counts: Sequence[int]) -> list[int]:
    """Whole shares of a total in the proportions of the counts.

    The largest remainders get the rest, earlier ones first.
    """
    exact = total * np.array(counts) / sum(counts)
    shares = exact.astype(int)
    # A large remainder is a small difference: it comes first.
    by_remainder = np.argsort(shares - exact, kind="stable")
    shares[by_remainder[: total - shares.sum()]] += 1
    return [int(share) for share in shares]
