"""The answers of learners, joined to the step graph: votes, labels, probabilities, weight.

The main head is called "situation" and votes for four situations or for eight classes. Each other
head votes no or yes on one question (p_risky_250ms) and publishes the probability of yes. Labels
come from the integer votes. Calibration follows and cannot change a label: vote shares pass one
affine map and a softmax (multinomial logistic calibration, fitted on held-out votes).

Where force decides "nothing", it has the last word on the votes: without contact all are for
nothing, in contact those for nothing count for grasp. So votes stay whole and their sum the same,
and all that is made of votes follows. What the learner says about slip in contact is unchanged.

The `reference_...` functions compute the same in numpy; verification compares a file with them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from onnx import TensorProto

from holdfast.core.contract import (
    CLASSES,
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    Json,
)
from holdfast.step.builder import GraphBuilder
from holdfast.step.learner import Learner, add_learner, votes_in_all
from holdfast.step.network import IntArray, Network, add_shares, network_shares

MAIN_HEAD = "situation"
"""The head that gives the label. Every other head answers one question with yes or no."""
FloatRows = npt.NDArray[np.float32]


@dataclass(frozen=True)
class VoteCalibration:
    """p = softmax(share @ weights + bias) of vote shares [B, K]; weights [K, K], bias [K]."""

    weights: npt.NDArray[np.float64]
    bias: npt.NDArray[np.float64]

    def to_json(self) -> Json:
        """As a JSON object, for the artifact and the metadata."""
        return {"weights": self.weights.tolist(), "bias": self.bias.tolist()}


@dataclass(frozen=True)
class Head:
    """A trained learner, the classes it votes for, and the calibration of its votes.

    classes: in the order of risk, which decides ties.
    label_weights: what each situation's votes count for the label, None for the same.
    """

    name: str
    classes: tuple[str, ...]
    learner: Learner
    calibration: VoteCalibration
    label_weights: tuple[float, ...] | None = None

    @property
    def votes_name(self) -> str:
        """The tensor of this head's votes."""
        return votes_name(self.name)


def votes_name(head: str) -> str:
    """The tensor of a head's votes."""
    return "votes" if head == MAIN_HEAD else f"votes_{head}"


def learned_name(name: str) -> str:
    """The tensor of a learner's votes `name`, where force decides "nothing" after it."""
    return f"learned_{name}"


def add_heads(
    graph: GraphBuilder, features: str, heads: list[Head], empty: str = ""
) -> None:
    """Join every head to the features; publishes the outputs of the model's interface.

    empty: [B, 1] bool by force; "" where the learner decides "nothing" too.
    """
    for head in heads:
        n_classes = len(head.classes)
        out = head.votes_name
        rule = ByForce.of(head)
        moves = empty and rule.is_main
        moved = rule.nothing_to_grasp().astype(np.float32) if moves else None
        learned = learned_name(out) if empty else out
        votes = add_learner(graph, head.learner, features, n_classes, learned, moved)
        if empty:
            votes = rule.choose(graph, votes, empty, out)
        graph.output(out, TensorProto.FLOAT, n_classes)
        if head.name != MAIN_HEAD:
            _publish_extra(graph, head, votes)
        elif head.classes == CLASSES:
            _publish_classes(graph, head, votes)
        else:
            _publish_label(graph, head, votes)
            _calibrated(graph, head, votes, "p_situation")
            graph.output("p_situation", TensorProto.FLOAT, len(SITUATIONS))


@dataclass(frozen=True)
class ByForce:
    """What the contact rule does to the votes of a head. votes_in_all: their sum in every row."""

    name: str
    classes: tuple[str, ...]
    votes_in_all: int

    @staticmethod
    def of(head: Head) -> ByForce:
        """The rule for a trained head."""
        return ByForce(head.name, head.classes, votes_in_all(head.learner))

    @property
    def is_main(self) -> bool:
        """Whether it is a head that votes for nothing."""
        return self.name == MAIN_HEAD

    def choose(self, graph: GraphBuilder, votes: str, empty: str, out: str) -> str:
        """Add the choice between votes in contact [B, K] and those of an empty hand."""
        without = np.float32(self.without_contact())
        return graph.node("Where", empty, without, votes, out=out)

    def in_contact(self, votes: IntArray) -> IntArray:
        """The learner's votes [N, K] after the rule, of a hand that touches something."""
        if not self.is_main:
            return votes
        return np.asarray(votes @ self.nothing_to_grasp())

    def without_contact(self) -> IntArray:
        """[K] votes of an empty hand: all for nothing, equally light and heavy; else all for no."""
        votes: IntArray = np.zeros(len(self.classes), dtype=np.int64)
        votes[0] = self.votes_in_all
        if self.classes == CLASSES:
            heavy = votes[0] // 2
            votes[:2] -= [heavy, -heavy]
        return votes

    def nothing_to_grasp(self) -> IntArray:
        """[K, K] that gives the votes for nothing to grasp, of the same weight."""
        n_classes = len(self.classes)
        per = n_classes // len(SITUATIONS)
        moved: IntArray = np.eye(n_classes, dtype=np.int64)
        for weight in range(per):
            moved[NOTHING * per + weight, NOTHING * per + weight] = 0
            moved[NOTHING * per + weight, GRASP * per + weight] = 1
        return moved


@dataclass(frozen=True)
class Correction:
    """What a correction for one person does to the votes: a part of the risky ones are safe slip.

        x       = features, |features|, votes                of one sample
        no, yes = shares of the network's two classes on x
        taken   = floor(no * risky votes)                    moved to safe slip of the same weight

    Hand-overs and holding show only what is no slip, so risky votes are taken and never added.
    Raises ValueError for a network of other than two classes.
    """

    network: Network

    def __post_init__(self) -> None:
        if self.network.n_classes != 2:
            raise ValueError("a correction's network has two classes")

    @staticmethod
    def rows(features: FloatRows, votes: IntArray) -> FloatRows:
        """[N, 2 F + K] inputs of the network."""
        parts = [features, np.abs(features), votes.astype(np.float32)]
        return np.concatenate(parts, axis=1)

    def corrected(self, features: FloatRows, votes: IntArray) -> IntArray:
        """Votes [N, K] after the correction: the reference for the file. votes: before it."""
        of_risky, to_safe = _moves(votes.shape[1])
        part = network_shares(self.network, self.rows(features, votes)) @ of_risky
        # float32 as in the file; votes are below 2^24, so their own conversion is exact
        taken = np.floor(votes.astype(np.float32) * part).astype(np.int64)
        return np.asarray(votes + taken @ to_safe.astype(np.int64))

    def add(
        self, graph: GraphBuilder, features: str, votes: str, n_classes: int, out: str
    ) -> None:
        """Add it to a graph, from features and votes to the corrected votes."""
        of_risky, to_safe = _moves(n_classes)
        size = graph.node("Abs", features)
        rows = graph.node("Concat", features, size, votes, axis=1)
        part = graph.node("MatMul", add_shares(graph, self.network, rows), of_risky)
        # floor makes whole numbers again, so the sums that follow are exact
        taken = graph.node("Floor", graph.node("Mul", votes, part))
        moved = graph.node("MatMul", taken, to_safe)
        graph.node("Add", votes, moved, out=out)


def _moves(n_classes: int) -> tuple[FloatRows, FloatRows]:
    """[2, K] the first of two shares for the risky classes, and [K, K] risky votes to safe slip.

    Every row of the second adds up to 0, so the sum of the votes stays.
    """
    per = n_classes // len(SITUATIONS)
    of_risky = np.zeros((2, n_classes), dtype=np.float32)
    to_safe = np.zeros((n_classes, n_classes), dtype=np.float32)
    for weight in range(per):
        risky = RISKY_SLIP * per + weight
        of_risky[0, risky] = 1.0
        to_safe[risky, risky] = -1.0
        to_safe[risky, SAFE_SLIP * per + weight] = 1.0
    return of_risky, to_safe


def _calibrated(graph: GraphBuilder, head: Head, votes: str, out: str = "") -> str:
    """[B, K] float32 probabilities; the division of votes into shares is part of the weights."""
    # Votes have the same sum in every row, so a share is a product with a constant.
    weights = head.calibration.weights / votes_in_all(head.learner)
    bias = np.float32(head.calibration.bias)
    logits = graph.node("Gemm", votes, np.float32(weights), bias)
    return graph.node("Softmax", logits, out=out, axis=1)


def _publish_extra(graph: GraphBuilder, head: Head, votes: str) -> None:
    yes = graph.constant(1, np.int64)
    probabilities = _calibrated(graph, head, votes)
    # the second of two classes is yes
    graph.node("Gather", probabilities, yes, out=head.name, axis=1)
    graph.output(head.name, TensorProto.FLOAT)


def _publish_label(
    graph: GraphBuilder, head: Head, votes: str, more: tuple[float, ...] = ()
) -> None:
    """votes [B, 4], and columns more that are never the largest. more: 1.0 for each of these."""
    if head.label_weights is not None:
        weights = np.asarray([*head.label_weights, *more], np.float32)
        votes = graph.node("Mul", votes, weights)

    # Of equal votes the last counts, which is the riskier situation.
    graph.node(
        "ArgMax", votes, out="situation", axis=1, keepdims=0, select_last_index=1
    )
    graph.output("situation", TensorProto.INT64)


def _publish_classes(graph: GraphBuilder, head: Head, votes: str) -> None:
    _calibrated(graph, head, votes, "p_class")
    graph.output("p_class", TensorProto.FLOAT, len(CLASSES))

    # a situation is the sum of its light and its heavy class; whole votes add up exactly
    pairs = np.kron(np.eye(len(SITUATIONS)), np.ones((2, 1)))
    graph.node("MatMul", "p_class", np.float32(pairs), out="p_situation")
    graph.output("p_situation", TensorProto.FLOAT, len(SITUATIONS))

    # "Nothing" has no weight, so its two classes do not count; a tie is heavy, which is riskier.
    # All votes less: heavy minus light is at most 0 then, and never the largest of the columns.
    heavier = np.array([0, 0] + [-1, 1] * 3) - 1.0
    columns = np.column_stack([pairs, heavier])
    counts = graph.node("MatMul", votes, np.float32(columns))
    _publish_label(graph, head, counts, more=(1.0,))
    last = graph.constant(len(SITUATIONS), np.int64)
    difference = graph.node("Gather", counts, last, axis=1)
    even = np.float32(-votes_in_all(head.learner))
    graph.node("GreaterOrEqual", difference, even, out="weight")
    graph.output("weight", TensorProto.BOOL)


def reference_outputs(head: Head, votes: IntArray) -> dict[str, npt.NDArray[Any]]:
    """All that a file publishes of exact votes [N, K], by the names of its outputs."""
    probability = reference_probability(head, votes)
    found: dict[str, npt.NDArray[Any]] = {head.votes_name: votes}
    if head.name != MAIN_HEAD:
        # the second of two classes is yes
        return {**found, head.name: probability[:, 1]}

    found["situation"] = reference_label(head, votes)
    found["p_situation"] = probability
    if head.classes == CLASSES:
        found["p_class"] = probability
        found["p_situation"] = probability.reshape(len(votes), -1, 2).sum(axis=2)
        found["weight"] = reference_heavy(votes)
    return found


def riskier_argmax(votes: npt.NDArray[Any]) -> IntArray:
    """[N, K] votes -> [N] label: the largest; among equal ones the riskier (the last)."""
    from_the_last = np.argmax(votes[:, ::-1], axis=1)
    return np.asarray(votes.shape[1] - 1 - from_the_last, dtype=np.int64)


def reference_label(head: Head, votes: IntArray) -> IntArray:
    """[N, K] votes -> [N] label of a head; of the main one, a situation by its label weights."""
    if head.name != MAIN_HEAD:
        return riskier_argmax(votes)

    by_situation = situation_votes(votes)
    return riskier_argmax(weighted(by_situation, head.label_weights))


def weighted(votes: IntArray, weights: Sequence[float] | None) -> npt.NDArray[Any]:
    """Votes [N, 4] times the weights of their situations, in float32 as in the file."""
    if weights is None:
        return votes
    factors = np.asarray(weights, dtype=np.float32)
    return np.asarray(votes.astype(np.float32) * factors)


def reference_probability(head: Head, votes: IntArray) -> npt.NDArray[np.float64]:
    """Calibrated probabilities [N, K] of exact votes [N, K], in float64."""
    shares = votes / votes.sum(axis=1, keepdims=True)
    logits = shares @ head.calibration.weights + head.calibration.bias

    # less the largest, so that no exponential overflows
    largest = logits.max(axis=1, keepdims=True)
    raised = np.exp(logits - largest)
    total = raised.sum(axis=1, keepdims=True)
    return np.asarray(raised / total, dtype=np.float64)


def reference_heavy(votes: IntArray) -> npt.NDArray[np.bool_]:
    """[N, 8] votes -> [N]: at least as many for heavy as for light; "nothing" does not count."""
    # the first two classes are "nothing", light and heavy
    contact = votes[:, 2:]
    light = contact[:, 0::2].sum(axis=1)
    heavy = contact[:, 1::2].sum(axis=1)
    return np.asarray(heavy >= light, dtype=np.bool_)


def situation_votes(votes: IntArray) -> IntArray:
    """Votes for the four situations; of eight classes, light and heavy are added up."""
    if votes.shape[1] == len(SITUATIONS):
        return votes
    return votes.reshape(len(votes), -1, 2).sum(axis=2)
