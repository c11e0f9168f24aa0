"""Compares every node of an exported forest with scikit-learn's own trees.

Rows on a threshold can agree by chance, where both sides of a branch vote alike; the numbers of the
nodes cannot.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import helper

from holdfast.edge_runtime.errors import VerificationFailed
from holdfast.export.forest import Forest, leaf_votes
from holdfast.export.hard_rows import largest_float32_not_above
from holdfast.export.heads import Head
from holdfast.export.learner import forest_of, network_of
from holdfast.export.network import Network


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
    for numbers in (one for layer in network.layers for one in (layer.weights, layer.bias)):
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
        np.array(exported["nodes_values"], np.float32) != largest_float32_not_above(threshold)
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
    np.add.at(given, (rows, np.array(exported["target_ids"], int)), exported["target_weights"])
    leaf = np.concatenate([tree.tree_.feature for tree in forest.estimators_]) < 0
    return np.any(given != np.concatenate(votes) * leaf[:, None], axis=1)
