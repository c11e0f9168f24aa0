"""The input guard: what the rest of the graph sees is finite, in range, and honest about what is missing.

Per sensor: a sample is good if the driver says it is valid and all three channels are finite and in
range. A bad one is replaced by the last good one and the sensor is held. Two counters a sensor:

- lost: bad samples in a row; more than 20 ms of them and the sensor must settle again;
- good: good samples since the sensor (re)started, up to what the longest finite memory needs.

usable = good now and settled. unknown = fewer usable sensors than the model needs. A short gap makes
the state unknown while it lasts and no longer; a long one until the history is the sensor's own again.
NaN cannot pass: every comparison with NaN is false.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from onnx import TensorProto

from export.builder import GraphBuilder
from export.spec import RANGE_LIMIT, StepSpec


@dataclass(frozen=True)
class Guarded:
    """Names of the guarded tensors.

    now, last: [B, n, 3] this and the previous good sample. good: [B, n, 1] bool, delivered now.
    fresh: [B, n, 1] bool, the sensor has no past. usable: [B, n, 1] bool.
    """

    now: str
    last: str
    good: str
    fresh: str
    usable: str


def add_guard(graph: GraphBuilder, spec: StepSpec) -> Guarded:
    """Add the guard; publishes settled [B], unknown [B] and usable_sensors [B]."""
    last = graph.state("last", 3)
    sample = graph.reshape("sample", 0, spec.n_sensors, 3)
    good = _good(graph, spec, sample)
    now = graph.node("Where", good, sample, last)
    graph.keep("last", now)
    good_before = graph.state("good", 1)
    fresh = graph.node("Less", good_before, graph.constant(0.5))
    settled = _count(graph, spec, good, good_before)
    usable = graph.node("And", good, settled)
    needed = graph.constant(spec.min_valid_sensors, np.int32)
    graph.node("GreaterOrEqual", _total(graph, settled), needed, out="settled")
    graph.node("Less", _total(graph, usable, "usable_sensors"), needed, out="unknown")
    graph.output("settled", TensorProto.BOOL)
    graph.output("unknown", TensorProto.BOOL)
    graph.output("usable_sensors", TensorProto.INT32)
    return Guarded(now, last, good, fresh, usable)


def _good(graph: GraphBuilder, spec: StepSpec, sample: str) -> str:
    """[B, n, 1]: valid, and all three channels finite and in range."""
    in_range = graph.node("Less", graph.node("Abs", sample), graph.constant(RANGE_LIMIT[spec.unit]))
    valid = graph.node("Unsqueeze", "valid", graph.ints(2))
    return graph.node("ReduceMin", graph.node("And", in_range, valid), graph.ints(2), keepdims=1)


def _count(graph: GraphBuilder, spec: StepSpec, good: str, good_before: str) -> str:
    """Advance both counters; returns settled [B, n, 1]."""
    one, zero = graph.constant(1.0), graph.constant(0.0)
    longer = graph.node("Add", graph.state("lost", 1), one)
    lost = graph.node("Where", good, zero, graph.node("Min", longer, graph.constant(spec.gap_samples + 1.0)))
    graph.keep("lost", lost)
    too_long = graph.node("Greater", lost, graph.constant(float(spec.gap_samples)))
    more = graph.node("Min", graph.node("Add", good_before, one), graph.constant(float(spec.settle_samples)))
    counted = graph.node("Where", good, more, graph.node("Where", too_long, zero, good_before))
    graph.keep("good", counted)
    return graph.node("Greater", counted, graph.constant(spec.settle_samples - 0.5))


def _total(graph: GraphBuilder, flags: str, out: str = "") -> str:
    """[B, n, 1] bool -> [B] how many."""
    counts = graph.node("Cast", flags, to=TensorProto.INT32)
    return graph.node("ReduceSum", counts, graph.ints(1, 2), out=out, keepdims=0)
