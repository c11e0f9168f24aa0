"""What B hands' sensors report, a sample at a time: the same laws as a whole trial passes through.

An effect's random numbers are drawn for the whole trial before its first sample, from the same
streams. So a sample in the loop is that of the recording, bit for bit. One effect looks ahead: a
sample that is late by jitter lies between two readings, so with `timing_jitter` on the card every
sample reaches the loop one period late.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.simulation.effect import Signal
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.scene import Scene
from holdfast.simulation.sensor.chip import kept_rows, late_s
from holdfast.simulation.sensor.magnet import calibrate
from holdfast.simulation.sensor.rows import PlannedLanes, RowEffect, Rows

IntArray = npt.NDArray[np.int64]
ON_THE_CLOCK = {"timing_jitter": late_s, "dropped_samples": kept_rows}
"""Effects that move or lose whole samples; what they draw."""


class LoopSensors:
    """The sensors of B trials, n_samples [B] long; latency: samples by which a reading is late."""

    def __init__(
        self, scene: Scene, trials: Sequence[PlannedTrial], counts: IntArray
    ) -> None:
        self.scene, self.effects = scene, scene.sensor_effects
        self.latency = int("timing_jitter" in self.effects)
        self._plans: dict[str, PlannedLanes] = {}
        times = [np.arange(n) / scene.card.rate_hz for n in counts]
        for name in self.effects:
            times = self._prepare(name, trials, times)
        self._before: dict[str, Rows] = {}
        self._readings: list[Rows] = []

    def _prepare(
        self, name: str, trials: Sequence[PlannedTrial], times: list[FloatArray]
    ) -> list[FloatArray]:
        """Draw an effect's plans; returns the times of the samples after it."""
        scene, law = self.scene, self.effects[name].make
        drawn = [scene.draw(name, trial) for trial in trials]
        each = list(
            zip(times, drawn, (scene.rng(name, trial) for trial in trials), strict=True)
        )
        if isinstance(law, RowEffect):
            sensors = trials[0].hand.n_contacts
            plans = [law.plan(of_one, rng, t_s, sensors) for t_s, of_one, rng in each]
        else:
            plans = [{name: ON_THE_CLOCK[name](*one)} for one in each]
        self._plans[name] = PlannedLanes(plans)
        if name != "timing_jitter":
            return times
        return [t_s + plan[name] for t_s, plan in zip(times, plans, strict=True)]

    def read(self, rows: IntArray, forces_n: FloatArray) -> tuple[Rows, BoolArray]:
        """(readings, lost [B]) at samples rows [B], from forces [B, S, 3], in the card's unit.

        With a latency these are the readings of the sample before. A lost sample never comes.
        """
        now = Rows(forces_n, np.ones(forces_n.shape[:2], dtype=np.bool_))
        unit, lost = "N", np.zeros(len(rows), dtype=np.bool_)
        for name, effect in self.effects.items():
            if effect.in_card_unit:
                now, unit = self._in_card_unit(now, unit)
            if name == "timing_jitter":
                now, rows = self._between(now, rows)
            elif name == "dropped_samples":
                lost = ~self._plans[name].at(rows)[name]
            else:
                now = self._apply(name, now, rows, lost)
                unit = effect.gives_unit or unit
        return self._in_card_unit(now, unit)[0], lost

    def _apply(self, name: str, now: Rows, rows: IntArray, lost: BoolArray) -> Rows:
        law: Any = self.effects[name].make
        plan = self._plans[name].at(rows)
        if not law.chained:
            made: Rows = law.apply(now, plan)
            return made
        before = self._before.get(name, now)
        made = law.apply(now, plan, before)
        self._before[name] = Rows(
            np.where(lost[:, None, None], before.values, made.values),
            np.where(lost[:, None], before.valid, made.valid),
        )
        return made

    def _between(self, now: Rows, rows: IntArray) -> tuple[Rows, IntArray]:
        """The readings of the sample before, taken late or early, and that sample's number.

        Between two readings the value changes evenly, as numpy.interp has it.
        """
        self._readings = [*self._readings[-2:], now]
        first, middle = self._readings[0], self._readings[-min(2, len(self._readings))]
        rows = np.maximum(rows - 1, 0)
        late = self._plans["timing_jitter"].at(rows)["timing_jitter"]
        early, rate_hz = late < 0.0, self.scene.card.rate_hz
        from_row = rows - early
        at_s, since_s = rows / rate_hz, from_row / rate_hz
        run_s = (from_row + 1) / rate_hz - since_s
        start = np.where(early[:, None, None], first.values, middle.values)
        end = np.where(early[:, None, None], middle.values, now.values)
        ahead_s = (at_s + late - since_s)[:, None, None]
        moved = (end - start) / run_s[:, None, None] * ahead_s + start
        values = np.where((late == 0.0)[:, None, None], middle.values, moved)
        return Rows(values, middle.valid), rows

    def _in_card_unit(self, rows: Rows, unit: str) -> tuple[Rows, str]:
        if unit != "uT" or self.scene.card.unit != "N":
            return rows, unit
        signal: Any = Signal(np.empty(0), rows.values, rows.valid, "uT")
        return replace(rows, values=calibrate(signal).values), "N"
