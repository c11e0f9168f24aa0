"""What B hands feel and what the model file answers, a sample at a time.

The sensors obey the same laws as in a whole trial: an effect's random numbers are drawn for the
whole trial before its first sample, from the same streams, so a sample in the loop is that of the
recording, bit for bit. One effect looks ahead: a sample that is late by jitter lies between two
readings, so with `timing_jitter` in the scene every sample reaches the loop one period late.

The very model file answers B hands at once, as on the hand: bias, graph, decision.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from copy import copy, deepcopy
from dataclasses import replace
from typing import Any

import numpy as np

from holdfast.core.contract import (
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    BoolArray,
    FloatArray,
    IntArray,
)
from holdfast.edge_runtime.batch import ManyHands
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.edge_runtime.graph import StepGraph
from holdfast.edge_runtime.grip import GripSense
from holdfast.edge_runtime.grip_control import forces_of
from holdfast.edge_runtime.preparation import Tare
from holdfast.simulation.effects.effect import Plan, PlanRequest, Rows
from holdfast.simulation.physics.objects import read_of, sensed_of
from holdfast.simulation.scenes.protocol import Trials
from holdfast.simulation.scenes.scene import Scene

OUTPUTS = ("p_situation", "situation", "unknown", "usable_sensors")
"""Outputs of the graph that a controller needs."""


class PlanBatch:
    """The plans of one effect for B trials, ready to be read a sample at a time."""

    def __init__(self, plans: Sequence[Plan]) -> None:
        self._moving: Plan = {}
        self._single: dict[str, list[Any]] = {}
        for name in plans[0]:
            # A plan with one row is the same at every sample and needs no place for each.
            arrays = [plan[name] for plan in plans]
            if max(map(len, arrays)) > 1:
                self._moving[name] = _stacked(arrays)
            else:
                self._single[name] = arrays
        self._choose(np.arange(len(plans)))

    def _choose(self, of: IntArray) -> None:
        """Each hand's trial among those that the plans were made for."""
        self._of = of
        self._fixed: Plan = {}
        for name, arrays in self._single.items():
            # Kept in their layout in memory, which decides in which order numpy sums.
            self._fixed[name] = np.concatenate([arrays[k] for k in of])

    def some(self, which: IntArray) -> PlanBatch:
        """The plans of some of the trials, which may repeat."""
        part = copy(self)
        part._choose(self._of[which])
        return part

    def at(self, rows: IntArray) -> Plan:
        """Plan of B rows: sample rows[b] of trial b."""
        plan = dict(self._fixed)
        for name, array in self._moving.items():
            plan[name] = array[rows, self._of]
        return plan


def _stacked(arrays: Sequence[Any]) -> Any:
    """[T, B, ..] of plans that may differ in length: none is asked for more rows than it has."""
    longest = max(map(len, arrays))
    shape = (longest, len(arrays), *arrays[0].shape[1:])
    whole = np.empty(shape, dtype=arrays[0].dtype)
    for trial, array in enumerate(arrays):
        whole[: len(array), trial] = array
    return whole


class LoopSensors:
    """The sensors of B trials, read a sample at a time; counts [B]: samples of each trial."""

    def __init__(self, scene: Scene, trials: Trials, counts: IntArray) -> None:
        self.scene = scene
        self.effects = scene.sensor_effects
        plans: dict[str, list[Plan]] = {name: [] for name in self.effects}
        for trial, count in zip(trials, counts.tolist(), strict=True):
            t_s = np.arange(count) / scene.file.rate_hz
            for name, effect in self.effects.items():
                drawn = scene.draw(name, trial.number)
                rng = scene.rng(name, trial)
                request = PlanRequest(drawn, rng, t_s, trial.hand.n_sensors)
                plan = effect.plan(request)
                plans[name].append(plan)
                # Later effects see the times at which samples are really taken.
                t_s = t_s + plan.get("late_s", 0.0)

        self._plans = {name: PlanBatch(of_trials) for name, of_trials in plans.items()}
        self._before: dict[str, Rows] = {}
        self._readings: list[Rows] = []

    def read(self, rows: IntArray, forces_n: FloatArray) -> Rows:
        """Readings at samples rows [B], from forces [B, S, 3], in the scene's unit.

        With timing jitter these are the readings of the sample before.
        """
        forces_n = sensed_of(self.scene.file.hand, forces_n)
        all_valid = np.ones(forces_n.shape[:2], dtype=np.bool_)
        now = Rows(forces_n, all_valid)

        for name, effect in self.effects.items():
            if effect.in_scene_unit:
                now = self.scene.in_unit(now)
            if name == "timing_jitter":
                # Later effects act on the row before, and take its plan.
                now, rows = self._between(now, rows)
                continue
            plan = self._plans[name].at(rows)
            if effect.whole is None:
                now = effect.make(now, plan)
            else:
                now = effect.make(now, plan, self._before.get(name, now))
                self._before[name] = now
            now = replace(now, unit=effect.gives_unit or now.unit)

        return read_of(self.scene.file.hand, self.scene.in_unit(now))

    def some(self, which: IntArray) -> LoopSensors:
        """The sensors of some of the hands, which may repeat, with all that they have felt."""
        part = copy(self)
        part._plans = {name: plans.some(which) for name, plans in self._plans.items()}
        part._before = {name: _rows(of, which) for name, of in self._before.items()}
        part._readings = [_rows(of, which) for of in self._readings]
        return part

    def _between(self, now: Rows, rows: IntArray) -> tuple[Rows, IntArray]:
        """The readings of the sample before, taken late or early, and that sample's number.

        Between two readings the value changes evenly, as numpy.interp has it.
        """
        # The readings of two samples before and of this one; the first has itself before it.
        self._readings = [*(self._readings or [now, now])[-2:], now]
        first, middle, _ = self._readings

        # The first sample has none before it, so it comes twice.
        rows = np.maximum(rows - 1, 0)
        late = self._plans["timing_jitter"].at(rows)["late_s"]
        early = late < 0.0
        rate_hz = self.scene.file.rate_hz

        # An early sample lies between the sample before it and itself.
        from_row = rows - early
        at_s = rows / rate_hz
        since_s = from_row / rate_hz
        until_s = (from_row + 1) / rate_hz
        run_s = until_s - since_s
        start = np.where(early[:, None, None], first.values, middle.values)
        end = np.where(early[:, None, None], middle.values, now.values)

        # Slope times distance, in numpy.interp's order of operations: equal to the last bit.
        slope = (end - start) / run_s[:, None, None]
        ahead_s = (at_s + late - since_s)[:, None, None]
        moved = slope * ahead_s + start
        punctual = (late == 0.0)[:, None, None]
        values = np.where(punctual, middle.values, moved)

        return replace(middle, values=values), rows


def _rows(of: Rows, which: IntArray) -> Rows:
    """Some rows, which may repeat."""
    return replace(of, values=of.values[which], valid=of.valid[which])


Between = Callable[[LoopSensors, Trials, IntArray], Any]
"""Puts something with a `read` between sensors and model: (sensors, trials, samples of each)."""


class HandModels:
    """One model file, B hands in one call of its graph; the bias of each is of its first rows."""

    def __init__(self, model: OpenedModel, hands: int) -> None:
        card = model.card
        self._model = model
        self._stepper: Any = model.stepper(OUTPUTS, hands)
        self._fill = card.filler()
        self._thumb = card.thumb
        self._tares = [Tare(card.preparation, card.n_channels) for _ in range(hands)]
        self._learned: tuple[FloatArray, FloatArray] | None = None

    @property
    def can_branch(self) -> bool:
        """Whether the state of a hand can be copied: a compiled library keeps its own."""
        return isinstance(self._stepper, StepGraph)

    def some(self, which: IntArray) -> HandModels:
        """The models of some of the hands, which may repeat, with all that they have seen."""
        part = copy(self)
        part._stepper = self._model.stepper(OUTPUTS, len(which))
        part._stepper.take(self._stepper, which)
        if self._learned is not None:
            sign, bias = self._learned
            part._learned = sign[which], bias[which]
        else:
            # Until all biases are known every hand learns its own.
            part._tares = [deepcopy(self._tares[k]) for k in which]
        return part

    def answer(
        self,
        values: FloatArray,
        valid: BoolArray,
        opening: BoolArray,
        overridden: BoolArray,
    ) -> GripSense:
        """What controllers get of one sample of every hand, forces summed over the sensors.

        values [B, C] in the model's unit, valid [B, S]; opening, overridden [B]: by the wearers.
        """
        # what stands between sensors and model may have put something there
        values = self._fill(values)
        if self._learned is not None:
            sign, bias = self._learned
            values = values * sign - bias
        else:
            values, valid = self._tared(values, valid)

        # The graph reads its inputs from the arrays that it was opened with.
        self._stepper.sample[:] = values
        self._stepper.valid[:] = valid
        answers = self._stepper.step()
        p_situation = answers["p_situation"]
        known = ~answers["unknown"]

        hands = ManyHands(len(values))
        grip_n, load_n = forces_of(hands, [*values.T], [*valid.T], self._thumb)
        degraded = known & (answers["usable_sensors"] < valid.shape[1])
        p_safe = p_situation[:, SAFE_SLIP].astype(np.float64)
        return GripSense(
            grip_n=grip_n,
            load_n=load_n,
            p_risky=p_situation[:, RISKY_SLIP].astype(np.float64),
            p_safe=np.where(degraded, 0.0, p_safe),
            known=known,
            empty=known & (answers["situation"] == NOTHING),
            opening=opening,
            overridden=overridden,
        )

    def _tared(
        self, values: FloatArray, valid: BoolArray
    ) -> tuple[FloatArray, BoolArray]:
        """The sample as every hand prepares it while some sensor's bias is not known."""
        made = []
        for tare, row, flags in zip(self._tares, values, valid, strict=True):
            made.append(tare.prepare(row, flags))
        # one product for all hands from here on
        if all(tare.known.all() for tare in self._tares):
            signs, biases = zip(*[tare.learned for tare in self._tares], strict=True)
            self._learned = np.stack(signs), np.stack(biases)
        prepared, known = zip(*made, strict=True)
        return np.stack(prepared), np.stack(known)
