"""A correction of the votes for one person: a part of the risky votes goes to safe slip.

    x     = features, |features|, votes               of one sample
    no, yes = shares of a network of two classes on x     (export/network.py: whole numbers)
    taken = floor(no * risky votes)                   moved to safe slip of the same weight

Hand-overs and holding show only what is no slip, so a correction takes risky votes and never adds
any. Votes stay whole numbers with the same sum, the same bits on every runtime and in every batch.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import onnx

from holdfast.core.contract import RISKY_SLIP, SAFE_SLIP, SITUATIONS
from holdfast.export.builder import GraphBuilder
from holdfast.export.network import (
    Float32Array,
    IntArray,
    Network,
    add_shares,
    network_shares,
)

PREFIX = "adapted_"
"""Begins the name of every tensor that a correction adds."""
BEFORE = f"{PREFIX}votes_before"
"""The base's votes, which keep their numbers under another name."""
VOTES = "votes"
FEATURES = "features"
"""The tensors of the base that a correction reads."""


@dataclass(frozen=True)
class Correction:
    """network: of two classes, no slip and slip, on `rows_of`. Raises ValueError for another.

    Its share of "no slip" is the part of the risky votes that is taken away.
    """

    network: Network

    def __post_init__(self) -> None:
        if self.network.n_classes != 2:
            raise ValueError("a correction's network has two classes")


def risky_of_shares(n_classes: int) -> Float32Array:
    """[2, K]: the first of two shares for the risky classes, 0 for all others."""
    # classes are ordered by risk: the risky ones are the last
    first_risky = RISKY_SLIP * n_classes // len(SITUATIONS)
    shares = np.zeros((2, n_classes), dtype=np.float32)
    shares[0, first_risky:] = 1.0
    return shares


def risky_to_safe(n_classes: int) -> Float32Array:
    """[K, K] that takes votes from risky classes and gives them to safe slip of the same weight."""
    per = n_classes // len(SITUATIONS)
    moved = np.zeros((n_classes, n_classes), dtype=np.float32)

    # every row adds up to 0, so the sum of the votes stays
    for k in range(per):
        risky = RISKY_SLIP * per + k
        safe = SAFE_SLIP * per + k
        moved[risky, risky] = -1.0
        moved[risky, safe] = 1.0

    return moved


def rows_of(features: Float32Array, votes: IntArray) -> Float32Array:
    """[N, 2 F + K] inputs of a correction."""
    parts = [features, np.abs(features), votes.astype(np.float32)]
    return np.concatenate(parts, axis=1)


def corrected_votes(
    correction: Correction, features: Float32Array, votes: IntArray
) -> IntArray:
    """Votes [N, K] after the correction: the reference for the file. votes: before it."""
    n = votes.shape[1]
    rows = rows_of(features, votes)
    shares = network_shares(correction.network, rows)
    part = shares @ risky_of_shares(n)

    # float32 as in the file; votes are below 2^24, so their own conversion is exact
    taken = np.floor(votes.astype(np.float32) * part).astype(np.int64)
    change = taken @ risky_to_safe(n).astype(np.int64)
    return np.asarray(votes + change)


def add_correction(model: onnx.ModelProto, correction: Correction) -> None:
    """Put it behind the votes of a model, in place: no other operator is changed."""
    (output,) = [output for output in model.graph.output if output.name == VOTES]
    n_classes = output.type.tensor_type.shape.dim[1].dim_value
    added, constants = _correction(correction, n_classes)

    # the correction takes over the name of the votes, so their readers need no change
    nodes = list(model.graph.node)
    (at,) = [k for k, node in enumerate(nodes) if VOTES in node.output]
    nodes[at].output[:] = [BEFORE]

    # ONNX wants nodes in the order in which they can run
    later = nodes[at + 1 :]
    del model.graph.node[at + 1 :]
    model.graph.node.extend([*added, *later])
    model.graph.initializer.extend(constants)


def _correction(
    correction: Correction, n_classes: int
) -> tuple[list[onnx.NodeProto], list[onnx.TensorProto]]:
    """Nodes and constants from `features` and the votes before to the votes."""
    # the number of sensors only matters to a graph with a state, which this part has not
    graph = GraphBuilder(1, PREFIX)
    size = graph.node("Abs", FEATURES)
    rows = graph.node("Concat", FEATURES, size, BEFORE, axis=1)
    shares = add_shares(graph, correction.network, rows)

    # floor makes whole numbers again, so the sums that follow are exact
    part = graph.node("MatMul", shares, risky_of_shares(n_classes))
    share_of_votes = graph.node("Mul", BEFORE, part)
    taken = graph.node("Floor", share_of_votes)
    moved = graph.node("MatMul", taken, risky_to_safe(n_classes))
    graph.node("Add", BEFORE, moved, out=VOTES)
    return graph.part()


def remove_correction(model: onnx.ModelProto) -> None:
    """The inverse of `add_correction`, in place. Raises ValueError where there is none."""
    graph = model.graph
    last = next(node for node in graph.node if VOTES in node.output)
    if last.op_type != "Add" or last.input[0] != BEFORE:
        raise ValueError("its votes have no correction")

    nodes = [node for node in graph.node if _is_of_base(node)]
    constants = [one for one in graph.initializer if not one.name.startswith(PREFIX)]
    for node in nodes:
        if node.output[0] == BEFORE:
            node.output[:] = [VOTES]

    # a copy, because clearing the graph ends the messages that it holds
    kept = onnx.GraphProto(node=nodes, initializer=constants)
    graph.ClearField("node")
    graph.ClearField("initializer")
    graph.node.extend(kept.node)
    graph.initializer.extend(kept.initializer)


def _is_of_base(node: onnx.NodeProto) -> bool:
    """Whether a node stands in the base, under this name or as the maker of its votes."""
    name = node.output[0]
    return name == BEFORE or (name != VOTES and not name.startswith(PREFIX))
