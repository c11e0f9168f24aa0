"""The features of one sample, in named groups; each knows how far back it looks.

All groups but one are made from a finite history of 0.5 s: x[t] is the guarded sample, Sum x the
sum over the sensors, l a lag in samples (0.05, 0.10, 0.17, 0.25, 0.37 and 0.50 s), Zs = max(Sum z,
floor). On a scripted set anything with a longer memory is a hidden clock; the one group that has it
(the band-pass bank rings for ever, if ever more softly) says so and is reported apart.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from itertools import groupby

import numpy as np
import numpy.typing as npt
from onnx import TensorProto

from edge_runtime.contact import NORMAL_FLOOR
from edge_runtime.contract import FloatArray
from edge_runtime.errors import UsageError
from export.builder import GraphBuilder
from export.guard import Guarded
from export.spec import HISTORY_S, WINDOW_S, StepSpec

LAGS_S = (0.05, 0.10, 0.17, 0.25, 0.37, 0.50)
SPANS_S = (0.10, 0.25, 0.50)
SCALED_LAGS = (1, 3, 5)
"""Which of LAGS_S the scaled differences use: 0.10, 0.25 and 0.50 s."""


@dataclass(frozen=True)
class FeatureGroup:
    """A named group: how to add it, how many features it has, its memory (inf: rings for ever),
    formula, reason."""

    add: Callable[[History], Triples | str]
    count: Callable[[StepSpec], int]
    memory_s: float
    formula: str
    reason: str


@dataclass(frozen=True)
class Triples:
    """Features that are rows of the pool: (x, y, z) of a sensor or of the sum, at a time or since
    one.

    places: rows of the pool. scaled: divided by Zs.
    """

    places: list[int]
    scaled: bool = False


class History:
    """The last 0.5 s of guarded samples, and a pool of what groups choose from (each node is added
    once)."""

    def __init__(
        self, graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str
    ) -> None:
        self.graph, self.spec, self.now, self.rectified = graph, spec, guarded.now, rectified
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
        and_sum = np.concatenate([np.eye(self.spec.n_channels), _over_sensors(self.spec)], axis=1)
        values = self.graph.node("MatMul", rows, self.graph.constant(and_sum))
        since = -np.eye(len(places))
        since[:, 0] = 1.0
        return self.graph.node("MatMul", self.graph.constant(since), values)

    @cached_property
    def normal(self) -> str:
        """[B, 1, 1]: Sum z[t]."""
        return self.summed_changes((0, 1), (2, 3))

    def summed_changes(self, rows: tuple[int, int], axes: tuple[int, int]) -> str:
        """Part of Sum x[t] (row 0) and Sum x[t] - Sum x[t-l] (a row a lag), first and one past the
        last each."""
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
        """[1 + lags, n + 1] where the pool has `changes`."""
        rows, columns = 1 + len(LAGS_S), self.spec.n_sensors + 1
        triples = self.graph.reshape(self.changes, 0, rows * columns, 3)
        return np.reshape(self.pooled(triples, rows * columns), (rows, columns))

    @cached_property
    def pool(self) -> str:
        """[B, triples, 3]: everything that was put in."""
        return (
            self._pool[0]
            if len(self._pool) == 1
            else self.graph.node("Concat", *self._pool, axis=1)
        )

    def chosen(self, groups: list[Triples]) -> str:
        """[B, 3 x triples]: rows of the pool, divided by Zs where they are scaled."""
        graph = self.graph
        places = [place for group in groups for place in group.places]
        scaled = np.concatenate([np.full((len(group.places), 1), group.scaled) for group in groups])
        triples = graph.node("Gather", self.pool, graph.ints(*places), axis=1)
        if scaled.any():
            normal = graph.node("Mul", self.normal, graph.constant(scaled))
            scale = np.where(scaled, NORMAL_FLOOR[self.spec.unit], 1.0)
            triples = graph.node("Div", triples, graph.node("Max", normal, graph.constant(scale)))
        return graph.node("Flatten", triples, axis=1)


def _over_sensors(spec: StepSpec) -> FloatArray:
    """[C, 3]: channels to their sum over the sensors."""
    return np.tile(np.eye(3), (spec.n_sensors, 1))


def _window(h: History) -> Triples:
    first, count = h.length - h.spec.window_samples, h.spec.window_samples
    triples = h.graph.reshape(
        h.graph.columns(h.samples, first, h.length), 0, count * h.spec.n_sensors, 3
    )
    places = h.pooled(triples, count * h.spec.n_sensors)
    return Triples(np.reshape(places, (count, -1)).T.ravel().tolist())


def _now(h: History) -> Triples:
    return Triples(h.change_places[0, :-1].tolist())


def _differences(h: History) -> Triples:
    return Triples(h.change_places[1:, :-1].T.ravel().tolist())


def _sums(h: History) -> Triples:
    return Triples(h.change_places[:, -1].tolist())


def _scaled_sums(h: History) -> Triples:
    return Triples(h.change_places[1:, -1].tolist(), scaled=True)


def _scaled_now(h: History) -> Triples:
    return Triples(_now(h).places, scaled=True)


def _scaled_differences(h: History) -> Triples:
    rows = [1 + lag for lag in SCALED_LAGS]
    return Triples(h.change_places[rows, :-1].T.ravel().tolist(), scaled=True)


def _activity(h: History) -> Triples:
    later, earlier = (
        h.graph.columns(h.summed, 1, h.length),
        h.graph.columns(h.summed, 0, h.length - 1),
    )
    steps = h.graph.node("Abs", h.graph.node("Sub", later, earlier))
    means = h.graph.node("MatMul", h.graph.constant(_span_means(h.spec)), steps)
    return Triples(h.pooled(means, len(SPANS_S)), scaled=True)


def _span_means(spec: StepSpec) -> FloatArray:
    """[spans, L - 1]: each row averages the steps of the most recent span."""
    means = np.zeros((len(SPANS_S), spec.history_samples))
    for row, seconds in enumerate(SPANS_S):
        means[row, -spec.lag(seconds) :] = 1.0 / spec.lag(seconds)
    return means


def _shear(h: History) -> str:
    graph = h.graph
    shear = graph.node(
        "ReduceL2", h.summed_changes((1, 1 + len(LAGS_S)), (0, 2)), graph.ints(2), keepdims=1
    )
    scale = graph.node("Max", h.normal, graph.constant(NORMAL_FLOOR[h.spec.unit]))
    both = graph.node("Concat", shear, graph.node("Div", shear, scale), axis=1)
    return graph.node("Flatten", both, axis=1)


def _ranges(h: History) -> Triples:
    graph, places = h.graph, []
    for span_s in SPANS_S:
        recent = graph.columns(h.summed, h.length - h.spec.lag(span_s) - 1, h.length)
        high = graph.node("ReduceMax", recent, graph.ints(1), keepdims=1)
        low = graph.node("ReduceMin", recent, graph.ints(1), keepdims=1)
        places += h.pooled(graph.node("Sub", high, low), 1)
    return Triples(places)


def _bands(h: History) -> str:
    by_channel = h.graph.node("Transpose", h.rectified, perm=[0, 2, 1])
    shear = [channel for channel in range(h.spec.n_channels) if channel % 3 < 2]
    return h.graph.node(
        "Flatten", h.graph.node("Gather", by_channel, h.graph.ints(*shear), axis=1), axis=1
    )


GROUPS: dict[str, FeatureGroup] = {
    "window": FeatureGroup(
        _window,
        lambda s: s.n_channels * s.window_samples,
        WINDOW_S,
        "x[t-N+1] .. x[t]",
        "the thesis' raw window",
    ),
    "now": FeatureGroup(_now, lambda s: s.n_channels, 0.0, "x[t]", "where every finger stands"),
    "differences": FeatureGroup(
        _differences,
        lambda s: s.n_channels * len(LAGS_S),
        HISTORY_S,
        "x[t] - x[t-l]",
        "how every finger's force changed over half a second",
    ),
    "sums": FeatureGroup(
        _sums,
        lambda s: 3 * (1 + len(LAGS_S)),
        HISTORY_S,
        "Sum x[t]; Sum x[t] - Sum x[t-l]",
        "the whole grip: what only one finger feels cancels",
    ),
    "scaled_now": FeatureGroup(
        _scaled_now,
        lambda s: s.n_channels,
        0.0,
        "x[t] / Zs",
        "how the fingers share the load, whatever the load",
    ),
    "scaled_differences": FeatureGroup(
        _scaled_differences,
        lambda s: s.n_channels * len(SCALED_LAGS),
        HISTORY_S,
        "(x[t] - x[t-l]) / Zs, l = 0.10, 0.25, 0.50 s",
        "a finger's change counts relative to the grip it meets",
    ),
    "scaled_sums": FeatureGroup(
        _scaled_sums,
        lambda s: 3 * len(LAGS_S),
        HISTORY_S,
        "(Sum x[t] - Sum x[t-l]) / Zs",
        "the object's pull relative to the grip it meets",
    ),
    "activity": FeatureGroup(
        _activity,
        lambda s: 3 * len(SPANS_S),
        HISTORY_S,
        "mean |Sum x[u] - Sum x[u-1]| over the last 0.10, 0.25, 0.50 s, / Zs",
        "restlessness of the grip: rubbing and swinging, whatever their direction",
    ),
    "shear": FeatureGroup(
        _shear,
        lambda s: 2 * len(LAGS_S),
        HISTORY_S,
        "|Sum xy[t] - Sum xy[t-l]|, the same / Zs",
        "change of shear whatever its direction",
    ),
    "ranges": FeatureGroup(
        _ranges,
        lambda s: 3 * len(SPANS_S),
        HISTORY_S,
        "max - min of Sum x over 0.10, 0.25, 0.50 s",
        "what happened between the lags",
    ),
    "bands": FeatureGroup(
        _bands,
        lambda s: 2 * s.n_sensors * len(s.carried_bands()),
        float("inf"),
        "|band-pass output| per shear signal and band",
        "vibration of slip",
    ),
}


def feature_count(spec: StepSpec) -> int:
    """F, the number of features of a spec."""
    return sum(GROUPS[name].count(spec) for name in spec.groups)


def add_features(graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str) -> str:
    """Add the spec's groups in its order; publishes and returns `features` [B, F] float32."""
    unknown = [name for name in spec.groups if name not in GROUPS]
    if unknown or not spec.groups:
        raise UsageError(
            f"unknown feature groups: {', '.join(unknown) or 'none given'}",
            next_step=f"choose from {', '.join(GROUPS)}",
        )
    history = History(graph, spec, guarded, rectified)
    added = [GROUPS[name].add(history) for name in spec.groups]
    parts = list(_joined(history, added))
    joined = parts[0] if len(parts) == 1 else graph.node("Concat", *parts, axis=1)
    graph.node("Cast", joined, out="features", to=TensorProto.FLOAT)
    graph.output("features", TensorProto.FLOAT, feature_count(spec))
    return "features"


def _joined(history: History, added: list[Triples | str]) -> Iterator[str]:
    """[B, ..] tensors in order; groups of triples that follow each other are one."""
    for of_triples, groups in groupby(added, lambda group: isinstance(group, Triples)):
        if of_triples:
            yield history.chosen([group for group in groups if isinstance(group, Triples)])
        else:
            yield from (group for group in groups if isinstance(group, str))
