"""An effect of the sensor, row by row: what a whole trial and a closed loop both apply.

An effect is two functions. `plan` draws everything random before the first sample; `apply` turns
rows of readings into rows of readings and draws nothing. A row depends on another one only where
`apply` takes the row before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.simulation.effect import Drawn, Rows, Signal

Plan = dict[str, Any]
"""Arrays by name; the first axis has a row for each sample, or one row for all samples."""


@dataclass(frozen=True)
class PlanRequest:
    """What an effect draws its plan from.

    drawn    parameters of the trial; request["height_mm"] is one of them
    rng      the effect's random stream in the trial
    t_s      [T] times of the samples
    sensors  S
    """

    drawn: Drawn
    rng: np.random.Generator
    t_s: FloatArray
    sensors: int

    def __getitem__(self, name: str) -> Any:
        return self.drawn[name]

    @property
    def places(self) -> list[int]:
        """Of the sensors that the effect is about; a scene file numbers them from 1."""
        return [int(number) - 1 for number in self["sensors"]]

    def noise(self) -> FloatArray:
        """[T, S, 3] standard normal numbers from the stream."""
        return self.rng.normal(size=(len(self.t_s), self.sensors, 3))


@dataclass(frozen=True)
class RowEffect:
    """The two functions of an effect; as a function itself, it acts on a whole trial.

    plan     PlanRequest -> plan
    apply    (rows, plan) -> rows
    chained  `apply` also takes what it returned for the row before (itself at the first row)
    """

    plan: Callable[[PlanRequest], Plan]
    apply: Callable[..., Any]
    chained: bool = False

    def __call__(
        self, signal: Signal, drawn: Drawn, rng: np.random.Generator
    ) -> Signal:
        """A whole trial at once."""
        sensors = signal.values.shape[1]
        plan = self.plan(PlanRequest(drawn, rng, signal.t_s, sensors))
        law: Any = self._row_by_row if self.chained else self.apply
        made: Signal = law(signal, plan)
        return made

    def _row_by_row(self, rows: Rows, plan: Plan) -> Rows:
        """Apply a chained effect: every row needs what became of the one before."""
        values = np.empty_like(rows.values)
        valid = np.empty_like(rows.valid)
        before = Rows(rows.values[:1], rows.valid[:1])

        for k in range(len(values)):
            # Slices of one row, because `apply` needs the axis of the rows.
            row = Rows(rows.values[k : k + 1], rows.valid[k : k + 1])
            before = self.apply(row, row_of(plan, k), before)
            values[k] = before.values[0]
            valid[k] = before.valid[0]

        return replace(rows, values=values, valid=valid)


def as_drawn(request: PlanRequest) -> Plan:
    """The parameters themselves, [1, 1, 1] each: nothing random."""
    return {name: np.full((1, 1, 1), value) for name, value in request.drawn.items()}


def added(rows: Rows, plan: Plan) -> Rows:
    """What is read, and what the plan adds to it, in the unit of the rows."""
    return replace(rows, values=rows.values + plan["added"])


def scaled(rows: Rows, plan: Plan) -> Rows:
    """What is read times the plan's factor."""
    return replace(rows, values=rows.values * plan["factor"])


def row_of(plan: Plan, k: int) -> Plan:
    """The plan of sample k alone."""
    row = {}
    for name, array in plan.items():
        row[name] = array[k : k + 1] if len(array) > 1 else array
    return row


class PlanBatch:
    """The plans of one effect for B trials, ready to be read a sample at a time."""

    def __init__(self, plans: Sequence[Plan]) -> None:
        self._fixed: Plan = {}
        self._moving: Plan = {}
        for name in plans[0]:
            # A plan with one row is the same at every sample and needs no place for each.
            arrays = [plan[name] for plan in plans]
            if max(map(len, arrays)) > 1:
                self._moving[name] = _stacked(arrays)
            else:
                self._fixed[name] = np.concatenate(arrays)

    def at(self, rows: Any) -> Plan:
        """Plan of B rows: sample rows[b] of trial b."""
        plan = dict(self._fixed)
        trials = np.arange(len(rows))
        for name, array in self._moving.items():
            plan[name] = array[rows, trials]
        return plan


def _stacked(arrays: Sequence[Any]) -> Any:
    """[T, B, ..] of plans that may differ in length; the last row repeats."""
    longest = max(map(len, arrays))
    shape = (longest, len(arrays), *arrays[0].shape[1:])
    whole = np.empty(shape, dtype=arrays[0].dtype)
    for trial, array in enumerate(arrays):
        # A shorter trial is asked for its last sample until the longest has ended.
        whole[: len(array), trial] = array
        whole[len(array) :, trial] = array[-1]
    return whole
