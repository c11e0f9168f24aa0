"""A distortion of readings: drawn for a trial before its first sample, then applied row by row.

A law is three functions in one object. `plan` draws everything random; `apply` turns rows of
readings into rows of readings and draws nothing. Rows are the samples of one trial, or one sample
of many trials, so the very law acts on a recording and in a closed loop. A law that `remembers`
gets what it returned for the row before.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Protocol

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.hand_card import Side
from holdfast.simulation.effects.effect import Plan, Rows

Memory = Any
"""What a law keeps from row to row: arrays of one row a trial; None before the first row."""


@dataclass(frozen=True)
class PlanRequest:
    """What a law may know of a trial before it begins.

    rng    its random stream
    t_s    [T] times of the samples, s
    sides  [S] the side of every sensor
    """

    rng: np.random.Generator
    t_s: FloatArray
    sides: tuple[Side, ...]

    @property
    def sensors(self) -> int:
        """Number of sensors, S."""
        return len(self.sides)


class Law(Protocol):
    """One distortion. Values are in N; the first axis of all arrays is that of the rows."""

    remembers: bool

    def plan(self, request: PlanRequest) -> Plan:
        """Arrays by name, with a row for each sample or one row for all."""
        ...

    def apply(self, rows: Rows, plan: Plan, memory: Memory) -> tuple[Rows, Memory]:
        """(rows distorted, memory for the next row)."""
        ...


def distorted(
    law: Law, values: FloatArray, valid: BoolArray, request: PlanRequest
) -> tuple[FloatArray, BoolArray]:
    """(values [T, S, 3], valid [T, S]) of a whole trial after a law; the arguments stay."""
    plan = law.plan(request)
    if not law.remembers:
        made, _ = law.apply(Rows(values, valid), plan, None)
        return made.values, made.valid

    out = np.empty_like(values)
    out_valid = np.empty_like(valid)
    memory: Memory = None
    for k in range(len(values)):
        # Slices of one row, because a law needs the axis of the rows.
        row = Rows(values[k : k + 1], valid[k : k + 1])
        made, memory = law.apply(row, row_of(plan, k), memory)
        out[k] = made.values[0]
        out_valid[k] = made.valid[0]
    return out, out_valid


def row_of(plan: Plan, k: int) -> Plan:
    """The plan of sample k alone."""
    row = {}
    for name, array in plan.items():
        row[name] = array[k : k + 1] if len(array) > 1 else array
    return row
