"""The step graph without a forest: guard, bank, detectors, features; training runs it too."""

from __future__ import annotations

import onnx

from export.builder import GraphBuilder
from export.detectors import add_bank, add_detectors
from export.features import add_features
from export.guard import add_guard
from export.spec import StepSpec


def add_step(graph: GraphBuilder, spec: StepSpec) -> str:
    """Add the whole step up to the features; returns the features [B, F] float32."""
    guarded = add_guard(graph, spec)
    rectified = add_bank(graph, spec, guarded)
    add_detectors(graph, spec, guarded, rectified)
    return add_features(graph, spec, guarded, rectified)


def feature_graph(spec: StepSpec) -> onnx.ModelProto:
    """A model with outputs features, detectors, settled, unknown, usable_sensors and the state."""
    graph = GraphBuilder(spec.n_sensors)
    add_step(graph, spec)
    return graph.model()
