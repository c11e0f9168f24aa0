"""The features of one sample, in named groups; each knows how far back it looks.

All groups but one are made from a finite history of 0.5 s: x[t] is the guarded sample, Sum x the sum
over the sensors, l a lag in samples (0.05, 0.10, 0.17, 0.25, 0.37 and 0.50 s), Zs = max(Sum z, floor).
On a scripted set anything with a longer memory is a hidden clock; the one group that has it (the
band-pass bank rings for ever, if ever more softly) says so and is reported apart.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from onnx import TensorProto

from edge_runtime.contract import FloatArray, Unit
from edge_runtime.errors import UsageError
from export.builder import GraphBuilder
from export.guard import Guarded
from export.spec import HISTORY_S, WINDOW_S, StepSpec

LAGS_S = (0.05, 0.10, 0.17, 0.25, 0.37, 0.50)
SPANS_S = (0.10, 0.25, 0.50)
SCALED_LAGS = (1, 3, 5)
"""Which of LAGS_S the scaled differences use: 0.10, 0.25 and 0.50 s."""
NORMAL_FLOOR: dict[Unit, float] = {"N": 0.3, "uT": 100.0, "count": 300.0}
"""Least summed normal a ratio is taken over: in the air a ratio of noise to noise says nothing."""


@dataclass(frozen=True)
class FeatureGroup:
    """A named group: how to add it, how many features it has, its memory (inf: rings for ever), formula, reason."""

    add: Callable[[History], str]
    count: Callable[[StepSpec], int]
    memory_s: float
    formula: str
    reason: str


class History:
    """The last 0.5 s of guarded samples, and what several groups derive from it (each node added once)."""

    def __init__(self, graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str) -> None:
        self.graph, self.spec, self.now, self.rectified = graph, spec, guarded.now, rectified
        self.length = spec.history_samples + 1
        past = graph.state("history", 3 * spec.history_samples)
        self.flat = graph.node("Concat", past, guarded.now, axis=2)
        graph.keep("history", graph.columns(self.flat, 3, 3 * self.length, axis=2))

    @cached_property
    def samples(self) -> str:
        """[B, n, L, 3], oldest first."""
        return self.graph.reshape(self.flat, 0, 0, self.length, 3)

    @cached_property
    def differences(self) -> str:
        """[B, n, lags, 3]: x[t] - x[t-l]."""
        now = self.graph.node("Unsqueeze", self.now, self.graph.ints(2))
        return self.graph.node("Sub", now, self.lagged(self.samples, axis=2))

    @cached_property
    def summed(self) -> str:
        """[B, L, 3]: the sum over the sensors at every sample."""
        return self.graph.node("ReduceSum", self.samples, self.graph.ints(1), keepdims=0)

    @cached_property
    def summed_now(self) -> str:
        """[B, 1, 3]."""
        return self.graph.columns(self.summed, self.length - 1, self.length)

    @cached_property
    def summed_change(self) -> str:
        """[B, lags, 3]: Sum x[t] - Sum x[t-l]."""
        return self.graph.node("Sub", self.summed_now, self.lagged(self.summed, axis=1))

    @cached_property
    def normal_scale(self) -> str:
        """[B, 1, 1]: Zs = max(Sum z, floor)."""
        normal = self.graph.columns(self.summed_now, 2, 3, axis=2)
        return self.graph.node("Max", normal, self.graph.constant(NORMAL_FLOOR[self.spec.unit]))

    def lagged(self, history: str, axis: int) -> str:
        """A history with L on one axis -> the same at every lag."""
        places = [self.length - 1 - self.spec.lag(seconds) for seconds in LAGS_S]
        return self.graph.node("Gather", history, self.graph.ints(*places), axis=axis)


def _window(h: History) -> str:
    return h.graph.columns(h.flat, 3 * (h.length - h.spec.window_samples), 3 * h.length, axis=2)


def _now(h: History) -> str:
    return h.now


def _differences(h: History) -> str:
    return h.differences


def _sums(h: History) -> str:
    return h.graph.node("Concat", h.summed_now, h.summed_change, axis=1)


def _scaled_sums(h: History) -> str:
    return h.graph.node("Div", h.summed_change, h.normal_scale)


def _scaled_now(h: History) -> str:
    return h.graph.node("Div", h.now, h.normal_scale)


def _scaled_differences(h: History) -> str:
    chosen = h.graph.node("Gather", h.differences, h.graph.ints(*SCALED_LAGS), axis=2)
    return h.graph.node("Div", chosen, h.graph.node("Unsqueeze", h.normal_scale, h.graph.ints(3)))


def _activity(h: History) -> str:
    later, earlier = h.graph.columns(h.summed, 1, h.length), h.graph.columns(h.summed, 0, h.length - 1)
    steps = h.graph.node("Abs", h.graph.node("Sub", later, earlier))
    means = h.graph.node("MatMul", h.graph.constant(_span_means(h.spec)), steps)
    return h.graph.node("Div", means, h.normal_scale)


def _span_means(spec: StepSpec) -> FloatArray:
    """[spans, L - 1]: each row averages the steps of the most recent span."""
    means = np.zeros((len(SPANS_S), spec.history_samples))
    for row, seconds in enumerate(SPANS_S):
        means[row, -spec.lag(seconds) :] = 1.0 / spec.lag(seconds)
    return means


def _shear(h: History) -> str:
    shear = h.graph.node("ReduceL2", h.graph.columns(h.summed_change, 0, 2, axis=2), h.graph.ints(2), keepdims=1)
    return h.graph.node("Concat", shear, h.graph.node("Div", shear, h.normal_scale), axis=1)


def _ranges(h: History) -> str:
    graph = h.graph
    parts = []
    for span_s in SPANS_S:
        recent = graph.columns(h.summed, h.length - h.spec.lag(span_s) - 1, h.length)
        high = graph.node("ReduceMax", recent, graph.ints(1), keepdims=1)
        parts.append(graph.node("Sub", high, graph.node("ReduceMin", recent, graph.ints(1), keepdims=1)))
    return graph.node("Concat", *parts, axis=1)


def _bands(h: History) -> str:
    return h.rectified


GROUPS: dict[str, FeatureGroup] = {
    "window": FeatureGroup(
        _window, lambda s: s.n_channels * s.window_samples, WINDOW_S, "x[t-N+1] .. x[t]", "the thesis' raw window"
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
    parts = [graph.node("Flatten", GROUPS[name].add(history), axis=1) for name in spec.groups]
    joined = graph.node("Concat", *parts, axis=1)
    graph.node("Cast", joined, out="features", to=TensorProto.FLOAT)
    graph.output("features", TensorProto.FLOAT, feature_count(spec))
    return "features"
