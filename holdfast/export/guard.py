"""The input guard: the rest of the graph gets finite values in range, and flags for missing ones.

A sample of a sensor is good if the driver says it is valid and all three channels are finite and in
range. A bad one is replaced by the last good one, and the sensor's filter state is held. NaN cannot
pass: every comparison with NaN is false.

The history of a sensor is one number, its place, stepped by a table (`_next_places`):

    0                            fresh: it has no past
    (delivered, lost in a row)   higher with more delivered samples, lower with more lost ones
    the last                     settled and good now: usable

More than 20 ms lost in a row lead back to 0, and the sensor must settle again. unknown = fewer
usable sensors than the model needs. A short gap makes the state unknown while it lasts; a long one
until the whole history is of good samples again.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from onnx import TensorProto

from holdfast.core.contract import FloatArray
from holdfast.export.builder import GraphBuilder
from holdfast.export.spec import RANGE_LIMIT, StepSpec


@dataclass(frozen=True)
class Guarded:
    """Names of the guarded tensors, each [B, 1, C] but the past.

    now, last: this and the previous good sample. past: all samples before this one, in parts
    [B, rows, C], oldest first. good: bool, delivered now. begun: 1.0, or 0.0 where the sensor has
    no past. usable: bool.
    """

    now: str
    last: str
    past: tuple[str, ...]
    good: str
    begun: str
    usable: str


def add_guard(graph: GraphBuilder, spec: StepSpec) -> Guarded:
    """Add the guard; publishes settled [B], unknown [B] and usable_sensors [B]."""
    oldest, older = (
        graph.state("oldest", 1),
        graph.state("older", spec.history_samples - 2),
    )
    last, place = graph.state("last", 1), graph.state("place", 1)
    share = _share_of_good(graph, spec)
    good = graph.node("GreaterOrEqual", share, graph.constant(1.0))
    now = graph.node("Where", good, "sample", last)
    # each row takes the value of the next newer one
    for name, following in (("oldest", older), ("older", last), ("last", now)):
        graph.keep(name, following)
    begun = graph.node("Min", place, graph.constant(1.0))
    # rounds a share down
    entry = graph.node("Cast", graph.node("Add", place, share), to=TensorProto.INT64)
    following = graph.node("Gather", graph.constant(_next_places(spec)), entry)
    graph.keep("place", following)
    usable = _publish(graph, spec, following)
    return Guarded(now, last, (oldest, older, last), good, begun, usable)


def _share_of_good(graph: GraphBuilder, spec: StepSpec) -> str:
    """[B, 1, C]: good quarters of a sensor: three channels in range, and the valid flag."""
    in_range = graph.node(
        "Less", graph.node("Abs", "sample"), graph.constant(RANGE_LIMIT[spec.unit])
    )
    checks = graph.node(
        "Cast", graph.node("Concat", in_range, "valid", axis=2), to=TensorProto.DOUBLE
    )
    own = np.kron(np.eye(spec.n_sensors), np.ones((3, 3)))
    valid = np.kron(np.eye(spec.n_sensors), np.ones((1, 3)))
    return graph.node(
        "MatMul", checks, graph.constant(np.concatenate([own, valid]) / 4.0)
    )


def _places(spec: StepSpec) -> tuple[int, int]:
    """(first settled place, last place).

    A place is an even number; its entry in the table is that number, or the next if good.
    """
    a_delivery = 2 * (spec.gap_samples + 1)
    last = a_delivery * spec.settle_samples
    return last - a_delivery + 2, last


def _next_places(spec: StepSpec) -> FloatArray:
    """[last place + 2] next places: entry `place` if this sample is bad, `place + 1` if good."""
    bridged = spec.gap_samples + 1
    number = np.arange(1 + bridged * spec.settle_samples)
    delivered, lost = -(-number // bridged), -number % bridged
    after_bad = np.where((number == 0) | (lost + 1 == bridged), 0, number - 1)
    after_good = bridged * np.minimum(delivered + 1, spec.settle_samples)
    return 2.0 * np.stack([after_bad, after_good], axis=1).ravel()


def _publish(graph: GraphBuilder, spec: StepSpec, place: str) -> str:
    """Publish the flags; returns usable [B, 1, C]. A sensor counts three times, once a channel."""
    settled, last = (
        graph.node("Greater", place, graph.constant(at - 1.0)) for at in _places(spec)
    )
    needed = graph.constant(3 * spec.min_valid_sensors, np.int32)
    graph.node("GreaterOrEqual", _count(graph, settled), needed, out="settled")
    usable = _count(graph, last)
    graph.node("Less", usable, needed, out="unknown")
    graph.node("Div", usable, graph.constant(3, np.int32), out="usable_sensors")
    graph.output("settled", TensorProto.BOOL)
    graph.output("unknown", TensorProto.BOOL)
    graph.output("usable_sensors", TensorProto.INT32)
    return last


def _count(graph: GraphBuilder, flags: str) -> str:
    """[B, 1, C] bool -> [B] number of channels."""
    return graph.node(
        "ReduceSum",
        graph.node("Cast", flags, to=TensorProto.INT32),
        graph.ints(1, 2),
        keepdims=0,
    )
