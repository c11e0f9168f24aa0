"""The features of one sample in named groups, each with its memory.

All groups but one use a finite history of 0.5 s: x[t] is the guarded sample, Sum x the sum over the
sensors, l a lag in samples (0.05, 0.10, 0.17, 0.25, 0.37 and 0.50 s), Zs = max(Sum z, floor). In a
scripted data set a longer memory acts as a hidden clock. Only the band-pass bank has one (its
response decays without end); it is marked and reported separately.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from itertools import groupby

import numpy as np
from onnx import TensorProto

from holdfast.core.contact import NORMAL_FLOOR
from holdfast.core.contract import FloatArray
from holdfast.core.errors import UsageError
from holdfast.export.builder import GraphBuilder
from holdfast.export.guard import Guarded
from holdfast.export.history import LAGS_S, History, Triples
from holdfast.export.spec import HISTORY_S, WINDOW_S, StepSpec

SPANS_S = (0.10, 0.25, 0.50)
SCALED_LAGS = (1, 3, 5)
"""Which of LAGS_S the scaled differences use: 0.10, 0.25 and 0.50 s."""
MORE_LAGS_S = (0.02, 0.075, 0.13, 0.21, 0.31, 0.43)
"""Lags between those of LAGS_S."""


@dataclass(frozen=True)
class FeatureGroup:
    """A named group of features; memory_s: inf for a response that never ends.

    add: adds it to a graph. count: its number of features.
    """

    add: Callable[[History], Triples | str]
    count: Callable[[StepSpec], int]
    memory_s: float
    formula: str
    reason: str


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
        "ReduceL2",
        h.summed_changes((1, 1 + len(LAGS_S)), (0, 2)),
        graph.ints(2),
        keepdims=1,
    )
    scale = graph.node("Max", h.normal, graph.constant(NORMAL_FLOOR[h.spec.unit]))
    both = graph.node("Concat", shear, graph.node("Div", shear, scale), axis=1)
    return graph.node("Flatten", both, axis=1)


def _ranges(h: History) -> Triples:
    places: list[int] = []
    for span_s in SPANS_S:
        places += h.pooled(_range(h, h.summed, span_s), 1)
    return Triples(places)


def _range(h: History, signal: str, span_s: float) -> str:
    """[B, 1, ..]: the largest minus the smallest of a signal [B, L, ..] over a span."""
    recent = h.graph.columns(signal, h.length - h.spec.lag(span_s) - 1, h.length)
    high = h.graph.node("ReduceMax", recent, h.graph.ints(1), keepdims=1)
    low = h.graph.node("ReduceMin", recent, h.graph.ints(1), keepdims=1)
    return h.graph.node("Sub", high, low)


def _more_differences(h: History) -> Triples:
    graph, lags = h.graph, [h.spec.lag(seconds) for seconds in MORE_LAGS_S]
    places = graph.ints(h.length - 1, *(h.length - 1 - lag for lag in lags))
    rows = graph.node("Gather", h.samples, places, axis=1)
    since = np.hstack([np.ones((len(lags), 1)), -np.eye(len(lags))])
    changes = graph.node("MatMul", graph.constant(since), rows)
    count = len(lags) * h.spec.n_sensors
    return Triples(h.pooled(graph.reshape(changes, 0, count, 3), count))


def _finger_ranges(h: History) -> Triples:
    places: list[int] = []
    for span_s in SPANS_S:
        by_finger = h.graph.reshape(
            _range(h, h.samples, span_s), 0, h.spec.n_sensors, 3
        )
        places += h.pooled(by_finger, h.spec.n_sensors)
    return Triples(places)


def _moments(h: History) -> Triples:
    """The arm of a sensor is its place in the row, from the middle."""
    middle = (h.spec.n_sensors - 1) / 2.0
    return _leaned(h, np.arange(h.spec.n_sensors, dtype=np.float64) - middle)


def _imbalance(h: History) -> Triples:
    """The first half of the sensors against the second."""
    middle = (h.spec.n_sensors - 1) / 2.0
    return _leaned(h, np.where(np.arange(h.spec.n_sensors) < middle, -1.0, 1.0))


def _leaned(h: History, arms: FloatArray) -> Triples:
    """Sum a x[t] and its changes, scaled, for arms [S] of the sensors."""
    by_arm = h.graph.constant(np.kron(arms[:, None], np.eye(3)))
    own = h.graph.columns(h.changes, 0, h.spec.n_channels, axis=2)
    rows = 1 + len(LAGS_S)
    return Triples(h.pooled(h.graph.node("MatMul", own, by_arm), rows), scaled=True)


def _bands(h: History) -> str:
    by_channel = h.graph.node("Transpose", h.rectified, perm=[0, 2, 1])
    shear = [channel for channel in range(h.spec.n_channels) if channel % 3 < 2]
    return h.graph.node(
        "Flatten",
        h.graph.node("Gather", by_channel, h.graph.ints(*shear), axis=1),
        axis=1,
    )


GROUPS: dict[str, FeatureGroup] = {
    "window": FeatureGroup(
        _window,
        lambda s: s.n_channels * s.window_samples,
        WINDOW_S,
        "x[t-N+1] .. x[t]",
        "the thesis' raw window",
    ),
    "now": FeatureGroup(
        _now, lambda s: s.n_channels, 0.0, "x[t]", "the force on every finger"
    ),
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
        "the whole grip: opposite forces on single fingers cancel",
    ),
    "scaled_now": FeatureGroup(
        _scaled_now,
        lambda s: s.n_channels,
        0.0,
        "x[t] / Zs",
        "how the fingers share the load, independent of its size",
    ),
    "scaled_differences": FeatureGroup(
        _scaled_differences,
        lambda s: s.n_channels * len(SCALED_LAGS),
        HISTORY_S,
        "(x[t] - x[t-l]) / Zs, l = 0.10, 0.25, 0.50 s",
        "change at a finger relative to the grip force",
    ),
    "scaled_sums": FeatureGroup(
        _scaled_sums,
        lambda s: 3 * len(LAGS_S),
        HISTORY_S,
        "(Sum x[t] - Sum x[t-l]) / Zs",
        "pull of the object relative to the grip force",
    ),
    "activity": FeatureGroup(
        _activity,
        lambda s: 3 * len(SPANS_S),
        HISTORY_S,
        "mean |Sum x[u] - Sum x[u-1]| over the last 0.10, 0.25, 0.50 s, / Zs",
        "activity of the grip: rubbing and swinging in any direction",
    ),
    "shear": FeatureGroup(
        _shear,
        lambda s: 2 * len(LAGS_S),
        HISTORY_S,
        "|Sum xy[t] - Sum xy[t-l]|, the same / Zs",
        "change of shear in any direction",
    ),
    "ranges": FeatureGroup(
        _ranges,
        lambda s: 3 * len(SPANS_S),
        HISTORY_S,
        "max - min of Sum x over 0.10, 0.25, 0.50 s",
        "changes between the lags",
    ),
    "more_differences": FeatureGroup(
        _more_differences,
        lambda s: s.n_channels * len(MORE_LAGS_S),
        HISTORY_S,
        "x[t] - x[t-l], l = 0.02, 0.075, 0.13, 0.21, 0.31, 0.43 s",
        "changes of every finger between the lags",
    ),
    "finger_ranges": FeatureGroup(
        _finger_ranges,
        lambda s: s.n_channels * len(SPANS_S),
        HISTORY_S,
        "max - min of x over 0.10, 0.25, 0.50 s",
        "rubbing and swinging at every finger",
    ),
    "moments": FeatureGroup(
        _moments,
        lambda s: 3 * (1 + len(LAGS_S)),
        HISTORY_S,
        "Sum a x[t] / Zs; Sum a (x[t] - x[t-l]) / Zs; a: place of the sensor from the middle",
        "torsion (x, y) and centre of pressure (z) along the row of sensors",
    ),
    "imbalance": FeatureGroup(
        _imbalance,
        lambda s: 3 * (1 + len(LAGS_S)),
        HISTORY_S,
        "the same with a = -1 for the first half of the sensors, 1 for the second",
        "one side of the hand carries or loses more than the other",
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


def add_features(
    graph: GraphBuilder, spec: StepSpec, guarded: Guarded, rectified: str
) -> str:
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
            yield history.chosen(
                [group for group in groups if isinstance(group, Triples)]
            )
        else:
            yield from (group for group in groups if isinstance(group, str))
