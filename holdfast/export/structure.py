"""Compares every node of an exported forest with scikit-learn's own trees.

Rows on a threshold can agree by chance, where both sides of a branch vote alike; the numbers of the
nodes cannot.

Rows that are hard for a converted learner: on its steps, and at the edges of float32.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper

from holdfast.core.errors import VerificationFailed
from holdfast.export.forest import Forest, leaf_votes
from holdfast.export.heads import Head
from holdfast.export.learner import Learner, features_in, forest_of, network_of
from holdfast.export.network import Inputs, Network
from holdfast.export.reference import FloatRows

THRESHOLD_ROWS = 20_000
STEP_ROWS, STEP_SHARE = 5_000, 0.2
"""Rows beside steps of a network's inputs, and the share of inputs that are moved there."""


def hard_rows(learner: Learner, rows: FloatRows, seed: int) -> FloatRows:
    """Hard rows [H, F] for all that is in a learner."""
    forest, network = forest_of(learner), network_of(learner)
    parts = [edge_rows(features_in(learner))]
    if forest is not None:
        parts.insert(0, threshold_rows(forest, rows, seed))
    if network is not None:
        parts.append(step_rows(network.inputs, rows, seed))
    return np.concatenate(parts)


def step_rows(inputs: Inputs, rows: FloatRows, seed: int) -> FloatRows:
    """Rows in which some inputs are where rounding steps, or one float32 beside it."""
    rng = np.random.default_rng(seed)
    hard = rows[rng.integers(len(rows), size=STEP_ROWS)].copy()
    columns = rng.random(hard.shape) < STEP_SHARE
    half = np.floor(np.abs(inputs.gain) * rng.uniform(-1, 1, hard.shape)) + 0.5
    squashed = np.clip((half - inputs.offset) / inputs.gain, -0.999, 0.999)
    at = (squashed * inputs.knee / (1.0 - np.abs(squashed))).astype(np.float32)
    towards = rng.choice(np.array([-np.inf, 0.0, np.inf], np.float32), size=hard.shape)
    return np.where(
        columns, np.where(towards == 0.0, at, np.nextafter(at, towards)), hard
    )


def threshold_rows(forest: Any, rows: FloatRows, seed: int) -> FloatRows:
    """Rows that reach a node of a tree with its threshold, or one float32 step beside it.

    All thresholds get all three values equally often, or a random choice if there are too many for
    THRESHOLD_ROWS. Each row is a held-out one, changed only so far that it reaches its node.
    """
    rng = np.random.default_rng(seed)
    nodes = _Nodes([tree.tree_ for tree in forest.estimators_])
    if not len(nodes.branches):
        return rows[:0]
    chosen = np.resize(rng.permutation(3 * len(nodes.branches)), THRESHOLD_ROWS)
    hard = rows[rng.integers(len(rows), size=THRESHOLD_ROWS)].copy()
    place, side = np.divmod(chosen, 3)
    at = nodes.branches[place]
    nodes.lead(hard, at)
    hard[np.arange(len(hard)), nodes.feature[at]] = nodes.beside[side, at]
    return hard


def largest_float32_not_above(threshold: npt.NDArray[np.float64]) -> FloatRows:
    """A float64 threshold for float32 rows: the largest float32 that still goes left."""
    near = threshold.astype(np.float32)
    return np.where(near > threshold, np.nextafter(near, np.float32(-np.inf)), near)


class _Nodes:
    """The nodes of all trees in one row; a node's number is its place there.

    beside: [3, nodes] for each node the largest float32 that goes left, the one below it, and the
    one above it, which goes right. branches: numbers of the nodes that are no leaves.
    """

    def __init__(self, trees: list[Any]) -> None:
        self.feature = np.concatenate([tree.feature for tree in trees])
        at = largest_float32_not_above(
            np.concatenate([tree.threshold for tree in trees])
        )
        infinite = np.float32(np.inf)
        self.beside = np.array(
            [at, np.nextafter(at, -infinite), np.nextafter(at, infinite)]
        )
        self.branches = np.flatnonzero(self.feature >= 0)
        first = np.cumsum([0] + [tree.node_count for tree in trees])[:-1].repeat(
            [tree.node_count for tree in trees]
        )
        left, right = (
            np.concatenate([getattr(tree, side) for tree in trees])[self.branches]
            + first[self.branches]
            for side in ("children_left", "children_right")
        )
        self._above, self._is_left = np.full(len(at), -1), np.zeros(len(at), dtype=bool)
        self._above[left] = self._above[right] = self.branches
        self._is_left[left] = True

    def lead(self, rows: FloatRows, nodes: npt.NDArray[np.intp]) -> None:
        """Change each row of [N, F] in place where it leaves the path to its node of [N], from the
        root on down."""
        path = []
        while (nodes >= 0).any():
            path.append(nodes)
            nodes = np.where(nodes >= 0, self._above[nodes], -1)
        for node, above in zip(path[-2::-1], path[:0:-1], strict=True):
            self._turn(rows, node, above)

    def _turn(
        self, rows: FloatRows, node: npt.NDArray[np.intp], above: npt.NDArray[np.intp]
    ) -> None:
        """Send rows from the node above, where there is one (-1: none), to its child, the node."""
        these = np.flatnonzero(above >= 0)
        above, left = above[these], self._is_left[node[these]]
        feature, (at, _, over) = self.feature[above], self.beside[:, above]
        wrong = (rows[these, feature] <= at) != left
        rows[these[wrong], feature[wrong]] = np.where(left, at, over)[wrong]


def edge_rows(n_features: int) -> FloatRows:
    """Rows of zeros of both signs, subnormals, the smallest and the largest finite numbers."""
    limits = np.finfo(np.float32)
    values = [
        0.0,
        -0.0,
        limits.smallest_subnormal,
        -limits.smallest_subnormal,
        limits.tiny,
        limits.max,
        limits.min,
    ]
    return np.repeat(np.array(values, dtype=np.float32)[:, None], n_features, axis=1)


def require_same_numbers(model: onnx.ModelProto, head: Head, votes_name: str) -> int:
    """Compare all numbers of a learner; returns how many nodes and weights it has.

    Raises VerificationFailed with the number of those that differ.
    """
    forest, network = forest_of(head.learner), network_of(head.learner)
    (node,) = [node for node in model.graph.node if node.output[0] == votes_name]
    count = 0
    if forest is not None:
        made_by = {node.output[0]: node for node in model.graph.node}
        trees = made_by[node.input[0]] if network is not None else node
        count += _same_trees(trees, forest, head)
    if network is not None:
        count += _same_weights(model, network, head)
    return count


def _same_weights(model: onnx.ModelProto, network: Network, head: Head) -> int:
    """Every matrix and every bias of the network is in the file, number by number."""
    stored = [onnx.numpy_helper.to_array(one) for one in model.graph.initializer]
    for numbers in (
        one for layer in network.layers for one in (layer.weights, layer.bias)
    ):
        if not any(np.array_equal(numbers, one) for one in stored):
            _refuse(head, numbers.size, network.n_weights)
    return network.n_weights


def _refuse(head: Head, wrong: int, of: int) -> None:
    raise VerificationFailed(
        f"head {head.name}: {wrong} of {of} nodes or weights differ from training",
        cause="a converter that treats them differently",
        next_step="report the versions that holdfast doctor prints",
    )


def _same_trees(node: onnx.NodeProto, forest: Forest, head: Head) -> int:
    """Features, thresholds, children and leaves."""
    exported = {one.name: helper.get_attribute_value(one) for one in node.attribute}
    trees = [tree.tree_ for tree in forest.estimators_]
    feature, threshold, left, right = (
        np.concatenate([getattr(tree, name) for tree in trees])
        for name in ("feature", "threshold", "children_left", "children_right")
    )
    branch = feature >= 0
    wrong = (
        np.array([mode == b"BRANCH_LEQ" for mode in exported["nodes_modes"]]) != branch
    ) | _leaves_differ(exported, forest, len(head.classes))
    wrong |= branch & (
        np.array(exported["nodes_values"], np.float32)
        != largest_float32_not_above(threshold)
    )
    for name, expected in (
        ("nodes_featureids", feature),
        ("nodes_truenodeids", left),
        ("nodes_falsenodeids", right),
    ):
        wrong |= branch & (np.array(exported[name]) != expected)
    if wrong.any():
        _refuse(head, int(wrong.sum()), len(wrong))
    return len(wrong)


def _leaves_differ(exported: dict[str, Any], forest: Forest, n_classes: int) -> Any:
    """[nodes] whether a node's votes differ from those of its leaf (a branch has none)."""
    votes = leaf_votes(forest, n_classes)
    starts = np.concatenate([[0], np.cumsum([len(tree) for tree in votes])])
    given = np.zeros((starts[-1], n_classes))
    rows = starts[np.array(exported["target_treeids"], int)] + np.array(
        exported["target_nodeids"], int
    )
    np.add.at(
        given, (rows, np.array(exported["target_ids"], int)), exported["target_weights"]
    )
    leaf = np.concatenate([tree.tree_.feature for tree in forest.estimators_]) < 0
    return np.any(given != np.concatenate(votes) * leaf[:, None], axis=1)
