"""Compares every node of an exported forest with scikit-learn's own trees.

Rows on a threshold can agree by chance, where both sides of a branch vote alike; the numbers of the
nodes cannot.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import onnx
from onnx import helper

from edge_runtime.errors import VerificationFailed
from export.forest import leaf_votes
from export.hard_rows import largest_float32_not_above
from export.heads import Head


def require_same_trees(model: onnx.ModelProto, head: Head, votes_name: str) -> int:
    """Compare features, thresholds, children and leaves; returns the number of nodes.

    Raises VerificationFailed with the number of nodes that differ.
    """
    (node,) = [node for node in model.graph.node if node.output[0] == votes_name]
    exported = {one.name: helper.get_attribute_value(one) for one in node.attribute}
    trees = [tree.tree_ for tree in head.forest.estimators_]
    feature, threshold, left, right = (
        np.concatenate([getattr(tree, name) for tree in trees])
        for name in ("feature", "threshold", "children_left", "children_right")
    )
    branch = feature >= 0
    wrong = (
        np.array([mode == b"BRANCH_LEQ" for mode in exported["nodes_modes"]]) != branch
    ) | _leaves_differ(exported, head)
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
        raise VerificationFailed(
            f"head {head.name}: {int(wrong.sum())} of {len(wrong)} nodes differ from training",
            cause="a converter that treats the trees differently",
            next_step="report the versions that holdfast doctor prints",
        )
    return len(wrong)


def _leaves_differ(exported: dict[str, Any], head: Head) -> Any:
    """[nodes] whether a node's votes differ from those of its leaf (a branch has none)."""
    votes = leaf_votes(head.forest, len(head.classes))
    starts = np.concatenate([[0], np.cumsum([len(tree) for tree in votes])])
    given = np.zeros((starts[-1], len(head.classes)))
    rows = starts[np.array(exported["target_treeids"], int)] + np.array(
        exported["target_nodeids"], int
    )
    np.add.at(given, (rows, np.array(exported["target_ids"], int)), exported["target_weights"])
    leaf = np.concatenate([tree.tree_.feature for tree in head.forest.estimators_]) < 0
    return np.any(given != np.concatenate(votes) * leaf[:, None], axis=1)
