"""A card compiled: the trials it asks for, the effects it names, and each trial simulated to what
its sensors report.

Only what is on the card is in the lists below; nothing else is called, drawn or kept.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from edge_runtime.contract import FloatArray
from simulation.camera.frames import Camera, Frames
from simulation.card import Card, Row
from simulation.effect import PhysicsEffects, Signal, stream
from simulation.effects import EFFECTS, conversion_s
from simulation.loop import pressure
from simulation.protocol import Trial, draw_trial
from simulation.run import Done, Loop, Motion, motions
from simulation.script import grid_of
from simulation.sensor.calibration import calibrate
from simulation.truth import Truth, truth_of

BATCH = 1000
"""About so many trials are stepped together: fewer waste time on calls, more on memory."""
HOOKS = {"acceleration_m_s2": "shakes", "scale": "textures", "terms": "lags", "turn": "turns"}


@dataclass(frozen=True)
class SimulatedTrial:
    """One trial simulated: what the sensors report, what really happened, and the effects'
    draws."""

    trial: Trial
    signal: Signal
    motion: Motion
    truth: Truth
    effects: dict[str, dict[str, Any]]
    hand_m: FloatArray | None


class Scene:
    """A card, ready to simulate any of its trials from one seed."""

    def __init__(self, card: Card, seed: int) -> None:
        self.card, self.seed = card, seed
        named = {name: EFFECTS[name] for name in card.effects}
        self.loop_effects = {
            n: e
            for n, e in named.items()
            if e.stage == "physics" and n not in ("brush", "averaging")
        }
        self.sensor_effects = {n: e for n, e in named.items() if e.stage == "sensor"}
        self.average_s = (
            conversion_s(self._constant("averaging", "averages")) if "averaging" in named else 0.0
        )
        self.camera = Camera(**card.camera) if card.camera else None
        self.pressure = (
            pressure(int(self._constant("brush", "count"))) if "brush" in named else pressure(1)
        )

    def trials(self, total: int | None = None) -> list[Trial]:
        """The card's trials; with a total, so many, spread over its rows as the card's counts
        are."""
        cells = [(row, name) for row in self.card.rows for name in row.objects or (None,)]
        counts = [row.count for row, _ in cells]
        if total is not None:
            counts = apportion(total, counts)
        return [
            self.trial(row, name, repetition * len(cells) + cell)
            for cell, ((row, name), count) in enumerate(zip(cells, counts, strict=True))
            for repetition in range(count)
        ]

    def trial(self, row: Row, name: str | None, number: int) -> Trial:
        """One trial; its number picks its random streams."""
        thing = self.card.objects[name] if name else next(iter(self.card.objects.values()))
        return draw_trial(number, thing, row.action, row.style, row.told, self.seed, self.card.hand)

    def run(
        self, trials: Sequence[Trial], done: Done = lambda trials: None
    ) -> Iterator[SimulatedTrial]:
        """Simulate trials, those of like length together; yields them as they are done.

        done: told now and then how many trials' worth has been stepped.
        """
        order = sorted(trials, key=lambda trial: (self._steps(trial), trial.number))
        size = -(-len(order) // max(1, round(len(order) / BATCH)))
        for start in range(0, len(order), size):
            batch = order[start : start + size]
            yield from self._simulated(batch, partial(_tell, done, start, len(batch)))

    def run_together(self, trials: Sequence[Trial]) -> list[SimulatedTrial]:
        """One batch, in the order given."""
        return list(self._simulated(trials))

    def _simulated(
        self, trials: Sequence[Trial], done: Done = lambda share: None
    ) -> Iterator[SimulatedTrial]:
        if len(trials) == 1:  # numpy would sum a single lane in another order
            yield next(self._simulated([trials[0], trials[0]], done))
            return
        drawn = {name: [self._draw(name, trial) for trial in trials] for name in self.loop_effects}
        made = {
            name: effect.make(drawn[name], trials, [self._rng(name, trial) for trial in trials])
            for name, effect in self.loop_effects.items()
        }
        moved = motions(trials, self._loop(list(made.values()), len(trials)), done)
        for lane, (trial, motion) in enumerate(zip(trials, moved, strict=True)):
            yield self._told(
                trial,
                motion,
                {name: values[lane] for name, values in drawn.items()},
                made.get("arm"),
                lane,
            )

    def _loop(self, made: list[Any], lanes: int) -> Loop:
        lists: dict[str, tuple[Any, ...]] = {
            field: tuple(effect for effect in made if hasattr(effect, hook))
            for hook, field in HOOKS.items()
        }
        intervals = tuple(
            tuple(span for effect in made for span in effect.busy_s(lane)) for lane in range(lanes)
        )
        return Loop(
            self.card.rate_hz,
            self.card.step_s,
            self.pressure,
            PhysicsEffects(**lists),
            self.average_s,
            intervals,
        )

    def _told(
        self, trial: Trial, motion: Motion, drawn: dict[str, dict[str, Any]], arm: Any, lane: int
    ) -> SimulatedTrial:
        hand_m = None if arm is None else arm.motion_m(motion.t_s, lane)
        signal, sensed = self.sense(trial, motion.t_s, motion.forces_n)
        return SimulatedTrial(
            trial, signal, motion, truth_of(trial, motion), drawn | sensed, hand_m
        )

    def join(
        self, told: Sequence[SimulatedTrial]
    ) -> tuple[Signal, list[float], dict[str, dict[str, Any]]]:
        """Trials end to end, one sample apart: what the sensors report, when each begins in s, the
        sensors' draws.

        All through the sensors of the first: one hand for many grasps, not another hand with every
        grasp.
        """
        if len(told) == 1:
            return told[0].signal, [0.0], {}
        starts_s = [0.0]
        for one in told[:-1]:
            starts_s.append(starts_s[-1] + float(one.motion.t_s[-1]) + 1.0 / self.card.rate_hz)
        t_s = np.concatenate(
            [one.motion.t_s + start for one, start in zip(told, starts_s, strict=True)]
        )
        signal, drawn = self.sense(
            told[0].trial, t_s, np.concatenate([one.motion.forces_n for one in told])
        )
        return signal, starts_s, drawn

    def sense(
        self, trial: Trial, t_s: FloatArray, forces_n: FloatArray
    ) -> tuple[Signal, dict[str, dict[str, Any]]]:
        """Forces [T, S, 3] at t_s [T] through the card's sensor effects as drawn for a trial, in
        the card's unit."""
        signal = Signal(t_s, forces_n, np.ones(forces_n.shape[:2], dtype=np.bool_))
        drawn = {name: self._draw(name, trial) for name in self.sensor_effects}
        timing = ("timing_jitter", "dropped_samples", "stale_sensor")
        for name, effect in self.sensor_effects.items():
            if name in timing:
                signal = self._in_card_unit(signal)
            signal = effect.make(signal, drawn[name], self._rng(name, trial))
        return self._in_card_unit(signal), drawn

    def film(self, told: SimulatedTrial, camera: Camera) -> tuple[FloatArray, Frames]:
        """Stamps in s and frames of one trial, for a camera of the card's."""
        return camera.film(*self._before_camera(told))

    def shooting(self, told: SimulatedTrial, camera: Camera) -> Callable[[float], Frames]:
        """What takes one frame of a trial at a time."""
        return camera.shooting(*self._before_camera(told))

    def _before_camera(
        self, told: SimulatedTrial
    ) -> tuple[FloatArray, FloatArray, FloatArray, np.random.Generator]:
        hand_m = np.zeros_like(told.motion.position_m) if told.hand_m is None else told.hand_m
        return (
            told.motion.t_s,
            told.motion.position_m,
            hand_m,
            self._rng("camera_frames", told.trial),
        )

    def _in_card_unit(self, signal: Signal) -> Signal:
        return calibrate(signal) if signal.unit == "uT" and self.card.unit == "N" else signal

    def _draw(self, name: str, trial: Trial) -> dict[str, Any]:
        return EFFECTS[name].draw(
            self.card.effects[name], stream(self.seed, trial.number, f"{name} parameters")
        )

    def _rng(self, name: str, trial: Trial) -> np.random.Generator:
        return stream(self.seed, trial.number, name)

    def _constant(self, name: str, parameter: str) -> float:
        return float(
            self.card.effects[name].get(parameter, EFFECTS[name].parameters[parameter].default)
        )

    def _steps(self, trial: Trial) -> int:
        return len(grid_of(trial, self.card.rate_hz, self.card.step_s).at_s)


def _tell(done: Done, before: int, trials: int, share: float) -> None:
    done(before + share * trials)


def apportion(total: int, counts: Sequence[int]) -> list[int]:
    """Whole shares of a total as the counts are to each other (largest remainders, earlier
    first)."""
    exact = [total * count / sum(counts) for count in counts]
    shares = [int(share) for share in exact]
    by_remainder = sorted(range(len(counts)), key=lambda k: (shares[k] - exact[k], k))
    for k in by_remainder[: total - sum(shares)]:
        shares[k] += 1
    return shares
