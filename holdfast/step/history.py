"""What groups of features read: the last 0.5 s of guarded samples, and rows that they share."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NORMAL_AXIS, NORMAL_FLOOR, FloatArray
from holdfast.step.builder import GraphBuilder, added_once
from holdfast.step.guard import GuardOutputs
from holdfast.step.spec import StepSpec

LAGS_S = (0.05, 0.10, 0.17, 0.25, 0.37, 0.50)
"""Lags of the differences, in s: closer together for recent samples, up to the whole history."""


@dataclass(frozen=True)
class Triples:
    """Features that are rows of the pool: (x, y, z) of a sensor or of the sum, or their change.

    places: rows of the pool. scaled: divided by Zs.
    """

    places: list[int]
    scaled: bool = False


class History:
    """The last 0.5 s of guarded samples, and a pool of triples that groups share.

    length: L, the past samples and this one. What groups share is added by the first call that asks
    for it, and what no group asks for is not in the graph.
    """

    def __init__(
        self, graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs
    ) -> None:
        self.graph = graph
        self.spec = spec
        self.length = spec.history_samples + 1
        self.weight = guarded.weight
        self._parts = (*guarded.past, guarded.now, guarded.alive)
        # tensors [B, rows, 3] in the order in which groups put them in, and their rows in all
        self._pool: list[str] = []
        self._pooled = 0

    @added_once
    def samples(self) -> str:
        """[B, L + 1, C], oldest first; behind them 1.0, of a sensor without a past 0.0."""
        return self.graph.node("Concat", *self._parts, axis=1)

    @added_once
    def summed_steps(self) -> str:
        """[B, L - 1, 3]: the steps of the sum over the sensors, the oldest first."""
        summed = self.graph.node("MatMul", self.samples(), _over_sensors(self.spec))
        n_steps = self.length - 1
        later = np.eye(n_steps, self.length + 1, k=1)
        return self.graph.node("MatMul", later - np.eye(*later.shape), summed)

    @added_once
    def changes(self) -> str:
        """[B, 1 + lags, C + 3]: x[t] and every x[t] - x[t-l], of each sensor and of the sum."""
        now = self.length - 1
        unit = np.eye(self.length + 1)
        since = [unit[now] - unit[now - self.spec.lag(lag_s)] for lag_s in LAGS_S]
        rows = self.graph.node("MatMul", np.array([unit[now], *since]), self.samples())

        # the sum over the sensors as three more columns
        channels = np.eye(self.spec.n_channels)
        and_sum = np.hstack([channels, _over_sensors(self.spec)])
        return self.graph.node("MatMul", rows, and_sum)

    @added_once
    def normal(self) -> str:
        """[B, 1, 1]: Sum z[t]."""
        z = self.spec.n_channels + NORMAL_AXIS
        return self.graph.node("Slice", self.changes(), [0, z], [1, z + 1], [1, 2])

    def pooled(self, tensor: str, rows: int) -> list[int]:
        """Put [B, rows, 3] into the pool; returns the rows' places in it."""
        first = self._pooled
        self._pool.append(tensor)
        self._pooled += rows
        return list(range(first, self._pooled))

    @added_once
    def change_places(self) -> npt.NDArray[np.int64]:
        """[1 + lags, n + 1] rows of `changes` in the pool."""
        rows = 1 + len(LAGS_S)
        columns = self.spec.n_sensors + 1
        triples = self.graph.reshape(self.changes(), 0, rows * columns, 3)
        return np.reshape(self.pooled(triples, rows * columns), (rows, columns))

    @added_once
    def pool(self) -> str:
        """[B, triples, 3]: everything in the pool."""
        if len(self._pool) == 1:
            return self._pool[0]
        return self.graph.node("Concat", *self._pool, axis=1)

    def chosen(self, groups: list[Triples]) -> str:
        """[B, 3 x triples]: rows of the pool, divided by Zs where they are scaled."""
        graph = self.graph
        places: list[int] = []
        scaled: list[float] = []
        for group in groups:
            places += group.places
            scaled += [float(group.scaled)] * len(group.places)

        # one look-up for all groups: a node costs more than the numbers that it moves
        triples = graph.node("Gather", self.pool(), places, axis=1)
        if any(scaled):
            is_scaled = np.array(scaled)[:, None]
            scale = graph.node("Mul", self.normal(), is_scaled)
            # rows that are not scaled are divided by max(0, 1) = 1
            floor = np.where(is_scaled, NORMAL_FLOOR[self.spec.unit], 1.0)
            divisor = graph.node("Max", scale, floor)
            triples = graph.node("Div", triples, divisor)

        return graph.node("Flatten", triples, axis=1)


def _over_sensors(spec: StepSpec) -> FloatArray:
    """[C, 3]: channels to their sum over the sensors."""
    return np.tile(np.eye(3), (spec.n_sensors, 1))
