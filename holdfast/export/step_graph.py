"""The step graph without a learner: guard, bank, detectors, features; training runs parts of it."""

from __future__ import annotations

import math

import onnx

from holdfast.export.builder import GraphBuilder
from holdfast.export.detectors import add_bank, add_detectors
from holdfast.export.features import GROUPS, add_features
from holdfast.export.guard import add_guard
from holdfast.export.spec import StepSpec


def add_step(graph: GraphBuilder, spec: StepSpec) -> str:
    """Add the whole step up to the features; returns the features [B, F] float32."""
    guarded = add_guard(graph, spec)
    rectified = add_bank(graph, spec, guarded)
    add_detectors(graph, spec, guarded, rectified)
    return add_features(graph, spec, guarded, rectified)


def add_features_alone(graph: GraphBuilder, spec: StepSpec) -> str:
    """Add the same features without detectors; with the bank only where a group reads it."""
    guarded = add_guard(graph, spec)
    reads_bank = any(
        GROUPS[name].memory_s == math.inf for name in spec.groups if name in GROUPS
    )
    rectified = add_bank(graph, spec, guarded) if reads_bank else ""
    return add_features(graph, spec, guarded, rectified)


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
