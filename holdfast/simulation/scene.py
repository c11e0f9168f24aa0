"""A card compiled: its trials and effects, and each trial simulated to what its sensors report.

Only what the card names is in the lists below; nothing else is called, drawn or kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.camera_frames import Camera, Frames
from holdfast.simulation.card import Card, Row
from holdfast.simulation.closed_loop.drive import GripRecord
from holdfast.simulation.effect import Drawn, PhysicsEffects, Signal, stream
from holdfast.simulation.effects import EFFECTS, step_settings
from holdfast.simulation.protocol import PlannedTrial, draw_trial
from holdfast.simulation.run import Done, StepSettings, TrialMotion, motions
from holdfast.simulation.script import grid_of
from holdfast.simulation.sensor.magnet import calibrate
from holdfast.simulation.truth import Truth, truth_of

BATCH = 1000
"""About this many trials are stepped together: fewer waste time on calls, more on memory."""
HOOKS = {
    "acceleration_m_s2": "shakes",
    "scale": "textures",
    "terms": "lags",
    "turn": "turns",
}
"""Method of an effect -> the list of PhysicsEffects that it belongs to."""
HAND_MOTION = "motion_m"
"""Method of an effect that moves the hand where a camera can see it."""

Moved = Iterator[tuple[TrialMotion, GripRecord | None]]


@dataclass(frozen=True)
class SimulatedTrial:
    """One trial simulated: the sensors' report, the truth, the effects' draws.

    hand_m: [T, 3] position of the hand, None where no effect moves it. grip: what the card's
    controller did, None without one.
    """

    trial: PlannedTrial
    signal: Signal
    motion: TrialMotion
    truth: Truth
    effects: dict[str, Drawn]
    hand_m: FloatArray | None
    grip: GripRecord | None = None


class Scene:
    """A card, ready to simulate any of its trials from one seed.

    controlled: steps trials whose hand has a controller (closed_loop/recording.py); without it the
    hand keeps its grip, whatever the card says.
    """

    def __init__(
        self, card: Card, seed: int, controlled: Controlled | None = None
    ) -> None:
        self.card, self.seed, self._controlled = card, seed, controlled
        named = {name: EFFECTS[name] for name in card.effects}
        self.loop_effects = {
            n: e for n, e in named.items() if e.stage == "physics" and not e.sets
        }
        self.sensor_effects = {n: e for n, e in named.items() if e.stage == "sensor"}
        self.settings = StepSettings(
            card.rate_hz, card.step_s, **step_settings(card.effects)
        )
        self.camera = Camera(**card.camera) if card.camera else None

    def trials(self, total: int | None = None) -> list[PlannedTrial]:
        """The card's trials; with a total, that many in the proportions of the card's counts."""
        cells = [
            (row, name) for row in self.card.rows for name in row.objects or (None,)
        ]
        counts = [row.count for row, _ in cells]
        if total is not None:
            counts = apportion(total, counts)
        return [
            self.trial(row, name, repetition * len(cells) + cell)
            for cell, ((row, name), count) in enumerate(zip(cells, counts, strict=True))
            for repetition in range(count)
        ]

    def trial(self, row: Row, name: str | None, number: int) -> PlannedTrial:
        """One trial; its number picks its random streams."""
        thing = (
            self.card.objects[name] if name else next(iter(self.card.objects.values()))
        )
        return draw_trial(
            number, thing, row.action, row.style, row.values, self.seed, self.card.hand
        )

    def run(
        self, trials: Sequence[PlannedTrial], done: Done = lambda trials: None
    ) -> Iterator[SimulatedTrial]:
        """Simulate trials, those of similar length together; yields them as they are finished.

        done: called now and then with the number of trials stepped so far.
        """
        order = sorted(trials, key=lambda trial: (self._steps(trial), trial.number))
        size = -(-len(order) // max(1, round(len(order) / BATCH)))
        for start in range(0, len(order), size):
            batch = order[start : start + size]
            yield from self._simulated(batch, partial(_report, done, start, len(batch)))

    def run_together(
        self, trials: Sequence[PlannedTrial], done: Done = lambda share: None
    ) -> list[SimulatedTrial]:
        """One batch, in the order given; done: called now and then with the share stepped."""
        return list(self._simulated(trials, done))

    def _simulated(
        self, trials: Sequence[PlannedTrial], done: Done = lambda share: None
    ) -> Iterator[SimulatedTrial]:
        if len(trials) == 1:  # numpy would sum a single lane in another order
            yield next(self._simulated([trials[0], trials[0]], done))
            return
        drawn, made = self._made(trials)
        moves_hand = next(
            (effect for effect in made if hasattr(effect, HAND_MOTION)), None
        )
        moved = self._moved(trials, made, done)
        for lane, (trial, (motion, grip)) in enumerate(zip(trials, moved, strict=True)):
            hand_m = (
                None if moves_hand is None else moves_hand.motion_m(motion.t_s, lane)
            )
            signal, sensed = self.sense(trial, motion.t_s, motion.forces_n)
            effects = {name: values[lane] for name, values in drawn.items()} | sensed
            truth = truth_of(trial, motion, acted=grip is not None)
            yield SimulatedTrial(trial, signal, motion, truth, effects, hand_m, grip)

    def _moved(
        self, trials: Sequence[PlannedTrial], made: list[Any], done: Done
    ) -> Moved:
        """The motion of each trial, and the grip where a controller moves it."""
        if self._controlled is not None:
            return self._controlled(self, trials, done)
        stepped = motions(trials, self._step_settings(made, len(trials)), done)
        return ((motion, None) for motion in stepped)

    def step_settings_of(self, trials: Sequence[PlannedTrial]) -> StepSettings:
        """How a batch of these trials is stepped, with its effects."""
        return self._step_settings(self._made(trials)[1], len(trials))

    def _made(
        self, trials: Sequence[PlannedTrial]
    ) -> tuple[dict[str, list[Drawn]], list[Any]]:
        """(draws by effect, effects of the physics) of a batch."""
        drawn = {
            name: [self.draw(name, trial) for trial in trials]
            for name in self.loop_effects
        }
        made = [
            effect.make(
                drawn[name], trials, [self.rng(name, trial) for trial in trials]
            )
            for name, effect in self.loop_effects.items()
        ]
        return drawn, made

    def _step_settings(self, made: list[Any], lanes: int) -> StepSettings:
        lists: dict[str, tuple[Any, ...]] = {
            field: tuple(effect for effect in made if hasattr(effect, hook))
            for hook, field in HOOKS.items()
        }
        intervals = tuple(
            tuple(span for effect in made for span in effect.busy_s(lane))
            for lane in range(lanes)
        )
        return replace(self.settings, effects=PhysicsEffects(**lists), busy=intervals)

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
        for one in trials[:-1]:
            starts_s.append(
                starts_s[-1] + float(one.motion.t_s[-1]) + 1.0 / self.card.rate_hz
            )
        t_s = np.concatenate(
            [
                one.motion.t_s + start
                for one, start in zip(trials, starts_s, strict=True)
            ]
        )
        forces_n = np.concatenate([one.motion.forces_n for one in trials])
        signal, drawn = self.sense(trials[0].trial, t_s, forces_n)
        return signal, starts_s, drawn

    def sense(
        self, trial: PlannedTrial, t_s: FloatArray, forces_n: FloatArray
    ) -> tuple[Signal, dict[str, Drawn]]:
        """(signal, draws): forces [T, S, 3] at t_s [T] through a trial's sensors, in the card's
        unit."""
        signal = Signal(t_s, forces_n, np.ones(forces_n.shape[:2], dtype=np.bool_))
        drawn = {name: self.draw(name, trial) for name in self.sensor_effects}
        for name, effect in self.sensor_effects.items():
            if effect.in_card_unit:
                signal = self._in_card_unit(signal)
            signal = effect.make(signal, drawn[name], self.rng(name, trial))
        return self._in_card_unit(signal), drawn

    def film(self, one: SimulatedTrial, camera: Camera) -> tuple[FloatArray, Frames]:
        """(time stamps in s, frames) of one trial."""
        return camera.film(*self._before_camera(one))

    def shooting(
        self, one: SimulatedTrial, camera: Camera
    ) -> Callable[[float], Frames]:
        """A function that takes one frame of a trial at a given time, s."""
        return camera.shooting(*self._before_camera(one))

    def _before_camera(
        self, one: SimulatedTrial
    ) -> tuple[FloatArray, FloatArray, FloatArray, np.random.Generator]:
        motion, rng = one.motion, self.rng("camera_frames", one.trial)
        hand_m = np.zeros_like(motion.position_m) if one.hand_m is None else one.hand_m
        return motion.t_s, motion.position_m, hand_m, rng

    def _in_card_unit(self, signal: Signal) -> Signal:
        return (
            calibrate(signal)
            if signal.unit == "uT" and self.card.unit == "N"
            else signal
        )

    def draw(self, name: str, trial: PlannedTrial) -> Drawn:
        """Parameters of an effect in a trial."""
        return EFFECTS[name].draw(
            self.card.effects[name],
            stream(self.seed, trial.number, f"{name} parameters"),
        )

    def rng(self, name: str, trial: PlannedTrial) -> np.random.Generator:
        """The random stream of an effect in a trial."""
        return stream(self.seed, trial.number, name)

    def _steps(self, trial: PlannedTrial) -> int:
        return len(grid_of(trial, self.card.rate_hz, self.card.step_s).at_s)


Controlled = Callable[[Scene, Sequence[PlannedTrial], Done], Moved]
"""Steps trials in a closed loop: (scene, trials, done)."""


def _report(done: Done, before: int, trials: int, share: float) -> None:
    done(before + share * trials)


def apportion(total: int, counts: Sequence[int]) -> list[int]:
    """Whole shares of a total in the proportions of the counts (largest remainders, earlier
    first)."""
    exact = [total * count / sum(counts) for count in counts]
    shares = [int(share) for share in exact]
    by_remainder = sorted(range(len(counts)), key=lambda k: (shares[k] - exact[k], k))
    for k in by_remainder[: total - sum(shares)]:
        shares[k] += 1
    return shares
