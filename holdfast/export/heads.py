"""The answers of learners, joined to the step graph: votes, labels, probabilities, weight.

The main head is called "situation" and votes for four situations or for eight classes. Each other
head votes no or yes on one question (p_risky_250ms) and publishes the probability of yes. Labels
come from the integer votes. Calibration follows and cannot change a label: vote shares pass one
affine map and a softmax (multinomial logistic calibration, fitted on held-out votes).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from onnx import TensorProto

from holdfast.core.contract import CLASSES, SITUATIONS
from holdfast.core.reading import Json
from holdfast.export.builder import GraphBuilder
from holdfast.export.learner import Learner, add_learner, votes_in_all

MAIN_HEAD = "situation"


@dataclass(frozen=True)
class Calibration:
    """p = softmax(share @ weights + bias) of vote shares [B, K]; weights [K, K], bias [K]."""

    weights: npt.NDArray[np.float64]
    bias: npt.NDArray[np.float64]

    def to_json(self) -> Json:
        """As a JSON object, for the artifact and the metadata."""
        return {"weights": self.weights.tolist(), "bias": self.bias.tolist()}


@dataclass(frozen=True)
class Head:
    """A trained learner, the classes it votes for, and the calibration of its votes.

    label_weights: what each situation's votes count for the label, None for the same.
    """

    name: str
    classes: tuple[str, ...]
    learner: Learner
    calibration: Calibration
    label_weights: tuple[float, ...] | None = None


def add_heads(graph: GraphBuilder, features: str, heads: list[Head]) -> None:
    """Join every head to the features; publishes the outputs of the model's interface."""
    for head in heads:
        out = "votes" if head.name == MAIN_HEAD else f"votes_{head.name}"
        votes = add_learner(graph, head.learner, features, len(head.classes), out)
        graph.output(out, TensorProto.FLOAT, len(head.classes))
        if head.name != MAIN_HEAD:
            _publish_extra(graph, head, votes)
        elif head.classes == CLASSES:
            _publish_classes(graph, head, votes)
        else:
            _publish_label(graph, head, votes)
            _calibrated(graph, head, votes, "p_situation")
            graph.output("p_situation", TensorProto.FLOAT, len(SITUATIONS))


def _calibrated(graph: GraphBuilder, head: Head, votes: str, out: str = "") -> str:
    """[B, K] float32 probabilities; the division of votes into shares is part of the weights."""
    weights = head.calibration.weights / votes_in_all(head.learner)
    product = graph.node("MatMul", votes, graph.constant(weights, np.float32))
    logits = graph.node(
        "Add", product, graph.constant(head.calibration.bias, np.float32)
    )
    return graph.node("Softmax", logits, out=out, axis=1)


def _publish_extra(graph: GraphBuilder, head: Head, votes: str) -> None:
    yes = graph.constant(1, np.int64)
    graph.node("Gather", _calibrated(graph, head, votes), yes, out=head.name, axis=1)
    graph.output(head.name, TensorProto.FLOAT)


def _publish_label(graph: GraphBuilder, head: Head, votes: str) -> None:
    if head.label_weights is not None:
        votes = graph.node("Mul", votes, graph.constant(head.label_weights, np.float32))
    graph.node(
        "ArgMax", votes, out="situation", axis=1, keepdims=0, select_last_index=1
    )
    graph.output("situation", TensorProto.INT64)


def _publish_classes(graph: GraphBuilder, head: Head, votes: str) -> None:
    _calibrated(graph, head, votes, "p_class")
    graph.output("p_class", TensorProto.FLOAT, len(CLASSES))
    pairs = graph.constant(
        np.kron(np.eye(len(SITUATIONS)), np.ones((2, 1))), np.float32
    )
    graph.node("MatMul", "p_class", pairs, out="p_situation")
    graph.output("p_situation", TensorProto.FLOAT, len(SITUATIONS))
    _publish_label(graph, head, graph.node("MatMul", votes, pairs))
    # "nothing" has no weight, so its two classes do not count; a tie is heavy, which is riskier
    heavier = graph.constant([0, 0] + [-1, 1] * 3, np.float32)
    difference = graph.node("MatMul", votes, heavier)
    graph.node(
        "GreaterOrEqual", difference, graph.constant(0.0, np.float32), out="weight"
    )
    graph.output("weight", TensorProto.BOOL)
