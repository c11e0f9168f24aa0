"""An effect of the sensor, row by row: what a whole trial and a closed loop both apply.

An effect is two functions. `plan` draws everything random before the first sample; `apply` turns
rows of readings into rows of readings and draws nothing. Rows are the samples of one trial, or one
sample of many trials; a row depends on another one only
where `apply` takes the row before.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Unit
from holdfast.simulation.effect import Drawn, Effect, Signal

Plan = dict[str, Any]
"""Arrays by name; the first axis has a row for each sample, or one row for all samples."""


@dataclass(frozen=True)
class Rows:
    """What S fingertips report in n rows: values [n, S, 3], valid [n, S]."""

    values: FloatArray
    valid: BoolArray


PlanFunction = Callable[[Drawn, np.random.Generator, FloatArray, int], Plan]
"""(parameters of the trial, its random stream, times [T] in s, S) -> plan."""


@dataclass(frozen=True)
class RowEffect:
    """The two functions of an effect.

    chained: `apply` also takes what it returned for the row before (itself at the first row).
    gives_unit: the unit after it, where it changes the unit.
    """

    plan: PlanFunction
    apply: Callable[..., Rows]
    chained: bool = False
    gives_unit: Unit | None = None

    def __call__(
        self, signal: Signal, drawn: Drawn, rng: np.random.Generator
    ) -> Signal:
        """A whole trial at once."""
        plan = self.plan(drawn, rng, signal.t_s, signal.values.shape[1])
        rows = Rows(signal.values, signal.valid)
        rows = self._one_by_one(rows, plan) if self.chained else self.apply(rows, plan)
        unit = self.gives_unit or signal.unit
        return replace(signal, values=rows.values, valid=rows.valid, unit=unit)

    def _one_by_one(self, rows: Rows, plan: Plan) -> Rows:
        made: list[Rows] = []
        for k in range(len(rows.values)):
            one = Rows(rows.values[k : k + 1], rows.valid[k : k + 1])
            made.append(self.apply(one, row_of(plan, k), made[-1] if made else one))
        return Rows(
            *(
                np.concatenate([getattr(m, n) for m in made])
                for n in ("values", "valid")
            )
        )


def row_of(plan: Plan, k: int) -> Plan:
    """The plan of sample k alone."""
    return {
        name: array[k : k + 1] if len(array) > 1 else array
        for name, array in plan.items()
    }


def row_effect(
    name: str,
    plan: PlanFunction,
    apply: Callable[..., Rows],
    *,
    chained: bool = False,
    gives_unit: Unit | None = None,
    **keys: Any,
) -> Effect:
    """An entry of the table of effects."""
    make = RowEffect(plan, apply, chained, gives_unit)
    return Effect(name, "sensor", make, gives_unit=gives_unit, **keys)


class PlannedLanes:
    """The plans of one effect for B trials, ready to be read a sample at a time."""

    def __init__(self, plans: Sequence[Plan]) -> None:
        arrays = {name: [plan[name] for plan in plans] for name in plans[0]}
        moving = {
            name for name, of in arrays.items() if any(len(one) > 1 for one in of)
        }
        self._fixed = {
            n: np.concatenate(of) for n, of in arrays.items() if n not in moving
        }
        self._moving = {n: _stacked(of) for n, of in arrays.items() if n in moving}

    def at(self, rows: Any) -> Plan:
        """Plan of B rows: sample rows[b] of trial b."""
        lanes = np.arange(len(rows))
        return self._fixed | {
            n: array[rows, lanes] for n, array in self._moving.items()
        }


def _stacked(arrays: Sequence[Any]) -> Any:
    """[T, B, ..] of plans that may differ in length; the last row repeats."""
    longest = max(len(one) for one in arrays)
    whole = np.empty(
        (longest, len(arrays), *arrays[0].shape[1:]), dtype=arrays[0].dtype
    )
    for lane, one in enumerate(arrays):
        whole[: len(one), lane] = one
        whole[len(one) :, lane] = one[-1]
    return whole
