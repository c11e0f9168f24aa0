"""The last 0.5 s of guarded samples in the graph, and the pool of triples that features share."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
import numpy.typing as npt

from holdfast.core.contact import NORMAL_FLOOR
from holdfast.core.contract import FloatArray
from holdfast.export.builder import GraphBuilder
from holdfast.export.guard import Guarded
from holdfast.export.spec import StepSpec

LAGS_S = (0.05, 0.10, 0.17, 0.25, 0.37, 0.50)


@dataclass(frozen=True)
class Triples:
    """Features that are rows of the pool: (x, y, z) of a sensor or of the sum, or their change.

    places: rows of the pool. scaled: divided by Zs.
    """

    places: list[int]
    scaled: bool = False


class History:
    """The last 0.5 s of guarded samples, and a pool of triples that groups share."""

    def __init__(
        self, graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str
    ) -> None:
        self.graph, self.spec, self.now, self.rectified = (
            graph,
            spec,
            guarded.now,
            rectified,
        )
        self._past = guarded.past
        self.length = spec.history_samples + 1
        self._pool: list[str] = []
        self._pooled = 0

    @cached_property
    def samples(self) -> str:
        """[B, L, C], oldest first."""
        return self.graph.node("Concat", *self._past, self.now, axis=1)

    @cached_property
    def summed(self) -> str:
        """[B, L, 3]: the sum over the sensors at every sample."""
        return self.graph.node(
            "MatMul", self.samples, self.graph.constant(_over_sensors(self.spec))
        )

    @cached_property
    def changes(self) -> str:
        """[B, 1 + lags, C + 3]: x[t] and every x[t] - x[t-l], of each sensor and of the sum."""
        places = [self.length - 1] + [
            self.length - 1 - self.spec.lag(seconds) for seconds in LAGS_S
        ]
        rows = self.graph.node("Gather", self.samples, self.graph.ints(*places), axis=1)
        and_sum = np.concatenate(
            [np.eye(self.spec.n_channels), _over_sensors(self.spec)], axis=1
        )
        values = self.graph.node("MatMul", rows, self.graph.constant(and_sum))
        since = -np.eye(len(places))
        since[:, 0] = 1.0
        return self.graph.node("MatMul", self.graph.constant(since), values)

    @cached_property
    def normal(self) -> str:
        """[B, 1, 1]: Sum z[t]."""
        return self.summed_changes((0, 1), (2, 3))

    def summed_changes(self, rows: tuple[int, int], axes: tuple[int, int]) -> str:
        """Part of Sum x[t] (row 0) and Sum x[t] - Sum x[t-l] (a row for each lag).

        rows, axes: (first, one past the last).
        """
        columns = [self.spec.n_channels + axis for axis in axes]
        starts, stops = zip(rows, columns, strict=True)
        return self.graph.node(
            "Slice",
            self.changes,
            self.graph.ints(*starts),
            self.graph.ints(*stops),
            self.graph.ints(1, 2),
        )

    def pooled(self, tensor: str, rows: int) -> list[int]:
        """Put [B, rows, 3] into the pool; returns the rows' places in it."""
        self._pool.append(tensor)
        self._pooled += rows
        return list(range(self._pooled - rows, self._pooled))

    @cached_property
    def change_places(self) -> npt.NDArray[np.int64]:
        """[1 + lags, n + 1] rows of `changes` in the pool."""
        rows, columns = 1 + len(LAGS_S), self.spec.n_sensors + 1
        triples = self.graph.reshape(self.changes, 0, rows * columns, 3)
        return np.reshape(self.pooled(triples, rows * columns), (rows, columns))

    @cached_property
    def pool(self) -> str:
        """[B, triples, 3]: everything in the pool."""
        return (
            self._pool[0]
            if len(self._pool) == 1
            else self.graph.node("Concat", *self._pool, axis=1)
        )

    def chosen(self, groups: list[Triples]) -> str:
        """[B, 3 x triples]: rows of the pool, divided by Zs where they are scaled."""
        graph = self.graph
        places = [place for group in groups for place in group.places]
        scaled = np.concatenate(
            [np.full((len(group.places), 1), group.scaled) for group in groups]
        )
        triples = graph.node("Gather", self.pool, graph.ints(*places), axis=1)
        if scaled.any():
            normal = graph.node("Mul", self.normal, graph.constant(scaled))
            scale = np.where(scaled, NORMAL_FLOOR[self.spec.unit], 1.0)
            triples = graph.node(
                "Div", triples, graph.node("Max", normal, graph.constant(scale))
            )
        return graph.node("Flatten", triples, axis=1)


def _over_sensors(spec: StepSpec) -> FloatArray:
    """[C, 3]: channels to their sum over the sensors."""
    return np.tile(np.eye(3), (spec.n_sensors, 1))
