"""The features of one sample in named groups, each with its memory, and the step up to them.

There are two lists of groups: those of single fingers, here, and those that are pooled over the
sensors (pooled.py). Both read one `History`: what the guard lets through, 0.5 s of it.

x[t] is the guarded sample, Sum x the sum over the sensors, l a lag in samples (0.05, 0.10, 0.17,
0.25, 0.37 and 0.50 s), Zs = max(Sum z, floor). In a scripted data set a longer memory acts as a
hidden clock, so no group has one.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from itertools import groupby

import msgspec
import numpy as np
import onnx
from onnx import TensorProto

from holdfast.core.errors import UsageError
from holdfast.step.builder import GraphBuilder
from holdfast.step.detectors import add_bank, add_detectors
from holdfast.step.guard import GuardOutputs, add_contact, add_guard
from holdfast.step.history import LAGS_S, History, Triples
from holdfast.step.pooled import FAMILIES, Family
from holdfast.step.pooled_graph import add_pooled
from holdfast.step.spec import HISTORY_S, WINDOW_S, StepSpec

SPANS_S = (0.10, 0.25, 0.50)
"""Spans of means, in s; each ends at the present sample."""
SCALED_LAGS = (1, 3, 5)
"""Which of LAGS_S the scaled differences use: 0.10, 0.25 and 0.50 s."""
ALL_LAGS = [1 + lag for lag in range(len(LAGS_S))]
SCALED_ROWS = [1 + lag for lag in SCALED_LAGS]
"""Rows of `History.changes`; row 0 is x[t]."""


@dataclass(frozen=True)
class FeatureGroup:
    """A named group of features. count: of features for a spec.

    add: its rows of the pool; None for a family of pooled.py: those that follow each other share
    their nodes.
    """

    add: Callable[[History], Triples] | None
    count: Callable[[StepSpec], int]
    memory_s: float
    formula: str
    reason: str


def _window(history: History) -> Triples:
    """The most recent samples of the sensors, as in the thesis."""
    graph = history.graph
    n_sensors = history.spec.n_sensors
    n_samples = history.spec.window_samples
    first = history.length - n_samples
    recent = graph.columns(history.samples(), first, history.length)
    triples = graph.reshape(recent, 0, n_samples * n_sensors, 3)
    places = history.pooled(triples, n_samples * n_sensors)

    # the thesis lists all samples of a sensor, then those of the next one
    by_sensor = np.reshape(places, (n_samples, -1)).T
    return Triples(by_sensor.ravel().tolist())


def _changes(history: History, rows: list[int], *, scaled: bool = False) -> Triples:
    """Rows of `changes`, sensor by sensor, the rows of each: 0 is x[t], 1 + k its change since
    LAGS_S[k]."""
    places = history.change_places()[rows, :-1]
    return Triples(places.T.ravel().tolist(), scaled)


def _scaled_sums(history: History) -> Triples:
    return Triples(history.change_places()[1:, -1].tolist(), scaled=True)


def _activity(history: History) -> Triples:
    # Without their signs: a swing to and fro must not cancel.
    steps = history.graph.node("Abs", history.summed_steps())

    # Each row averages the steps of the most recent span.
    rows = np.zeros((len(SPANS_S), history.spec.history_samples))
    for row, seconds in zip(rows, SPANS_S, strict=True):
        n_steps = history.spec.lag(seconds)
        row[-n_steps:] = 1.0 / n_steps

    # The means of all spans in one product. The matrix stands on the left, so each recording of
    # a batch is multiplied in the same order as alone.
    means = history.graph.node("MatMul", rows, steps)
    return Triples(history.pooled(means, len(SPANS_S)), scaled=True)


# A group needs its count before a graph exists: an artifact is checked against it.
GROUPS: dict[str, FeatureGroup] = {
    "window": FeatureGroup(
        _window,
        lambda s: s.n_channels * s.window_samples,
        WINDOW_S,
        "x[t-N+1] .. x[t]",
        "the thesis' raw window",
    ),
    "now": FeatureGroup(
        lambda h: _changes(h, [0]),
        lambda s: s.n_channels,
        0.0,
        "x[t]",
        "the force on every finger",
    ),
    "differences": FeatureGroup(
        lambda h: _changes(h, ALL_LAGS),
        lambda s: s.n_channels * len(LAGS_S),
        HISTORY_S,
        "x[t] - x[t-l]",
        "how every finger's force changed over half a second",
    ),
    "scaled_differences": FeatureGroup(
        lambda h: _changes(h, SCALED_ROWS, scaled=True),
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
}


def _pooled_group(family: Family) -> FeatureGroup:
    """A family of pooled.py as a group."""
    count = len(family.features)
    return FeatureGroup(None, lambda s: count, HISTORY_S, family.formula, family.reason)


GROUPS |= {name: _pooled_group(family) for name, family in FAMILIES.items()}


def feature_count(spec: StepSpec) -> int:
    """F, the number of features of a spec."""
    return sum(GROUPS[name].count(spec) for name in spec.groups)


def add_features(graph: GraphBuilder, spec: StepSpec, guarded: GuardOutputs) -> str:
    """Add the spec's groups in its order; publishes and returns `features` [B, F] float32."""
    unknown = [name for name in spec.groups if name not in GROUPS]
    if unknown or not spec.groups:
        raise UsageError(
            f"unknown feature groups: {', '.join(unknown) or 'none given'}",
            next_step=f"choose from {', '.join(GROUPS)}",
        )

    parts = _parts(History(graph, spec, guarded), spec.groups)
    joined = parts[0] if len(parts) == 1 else graph.node("Concat", *parts, axis=1)
    # float64 up to here: float32 is what the learners were trained on
    graph.node("Cast", joined, out="features", to=TensorProto.FLOAT)
    graph.output("features", TensorProto.FLOAT, feature_count(spec))
    return "features"


def _parts(history: History, names: tuple[str, ...]) -> list[str]:
    """[B, ..] tensors in the order of the groups; groups of one kind that follow each other share
    one."""
    # first all groups fill the pool, then each run of them chooses its rows of it
    triples: dict[str, Triples] = {}
    for name in names:
        add = GROUPS[name].add
        if add is not None:
            triples[name] = add(history)

    parts = []
    for is_pooled, run in groupby(names, FAMILIES.__contains__):
        if is_pooled:
            parts.append(add_pooled(history, list(run)))
        else:
            parts.append(history.chosen([triples[name] for name in run]))
    return parts


def add_step(graph: GraphBuilder, spec: StepSpec) -> tuple[str, str]:
    """Add the whole step up to the features; returns features [B, F] float32 and empty [B, 1].

    empty: bool by force, "" where force does not decide "nothing".
    """
    guarded = add_guard(graph, spec)
    bank = add_bank(graph, spec, guarded)
    add_detectors(graph, spec, guarded, bank)
    empty = add_contact(graph, spec, guarded, bank.means)
    return add_features(graph, spec, guarded), empty


def add_features_alone(graph: GraphBuilder, spec: StepSpec) -> str:
    """Add the same features without bank and detectors.

    The zero stays 0: training prepares a recording as a whole, with the bias of its own start.
    """
    spec = msgspec.structs.replace(spec, force_decides=False)
    return add_features(graph, spec, add_guard(graph, spec))


def features_alone(spec: StepSpec) -> onnx.ModelProto:
    """A model of these features: what training steps over whole sets."""
    graph = GraphBuilder(spec.n_sensors)
    add_features_alone(graph, spec)
    return graph.model()


def feature_graph(spec: StepSpec) -> onnx.ModelProto:
    """A model with outputs features, detectors, settled, unknown, usable_sensors and the state."""
    graph = GraphBuilder(spec.n_sensors)
    add_step(graph, spec)
    return graph.model()
