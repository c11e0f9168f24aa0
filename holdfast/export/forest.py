"""A random forest as integer votes: sums that are exact in any order, one declared rule for ties.

Leaf probabilities are quantised to integers that sum to 2^k in every leaf, with trees x 2^k < 2^24,
so float32 adds them exactly and a batch equals a single row. skl2onnx converts the trees (it rounds
float64 thresholds down to float32 correctly); only the weights of the leaves are ours. Ties go to
the riskier class: classes are ordered by risk, and the last of equal ones wins.
"""

from __future__ import annotations

import math
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier

from holdfast.export.builder import GraphBuilder

EXACT_FLOAT32 = 2**24
REMAINDER_DIGITS = 6
"""As float64, equal fractions differ by less than this; unequal ones by more, in a leaf with fewer
than a million rows."""
NODE_ATTRIBUTES = (
    "nodes_treeids",
    "nodes_nodeids",
    "nodes_modes",
    "nodes_featureids",
    "nodes_values",
    "nodes_truenodeids",
    "nodes_falsenodeids",
)

ROWS_AT_ONCE = 8192
"""So many stay in the processor's caches; a long stream at once takes twice as long."""

FOREST_KINDS = (RandomForestClassifier, ExtraTreesClassifier)
Forest: TypeAlias = RandomForestClassifier | ExtraTreesClassifier
IntArray = npt.NDArray[np.int64]


def vote_bits(n_trees: int) -> int:
    """Largest k with trees x 2^k < 2^24, at most 16."""
    return min(16, math.ceil(math.log2(EXACT_FLOAT32 / n_trees)) - 1)


def votes_of_trees(n_trees: int) -> int:
    """The sum of a row's votes."""
    return n_trees << vote_bits(n_trees)


def leaf_votes(forest: Forest, n_classes: int) -> list[IntArray]:
    """Integer votes [nodes, n_classes] of every tree; each leaf's sum to 2^k (largest remainder).

    The forest's classes_ are columns of the n_classes; a class it never saw has no votes.
    """
    scale = 1 << vote_bits(len(forest.estimators_))
    columns = np.asarray(forest.classes_, dtype=np.int64)
    votes = []
    for tree in forest.estimators_:
        wide = np.zeros((tree.tree_.node_count, n_classes), dtype=np.int64)
        wide[:, columns] = _quantise(tree.tree_.value[:, 0, :], scale)
        votes.append(wide)
    return votes


def forest_votes(
    forest: Forest, rows: npt.NDArray[np.float32], n_classes: int
) -> IntArray:
    """Exact integer votes [N, n_classes] of float32 rows [N, F]: the reference for the graph."""
    total = np.zeros((len(rows), n_classes), dtype=np.int64)
    trees = list(zip(forest.estimators_, leaf_votes(forest, n_classes), strict=True))
    for start in range(0, len(rows), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        for tree, votes in trees:
            total[some] += votes[tree.tree_.apply(rows[some])]
    return total


def _quantise(values: npt.NDArray[np.float64], scale: int) -> IntArray:
    """Rows of weights -> integers that sum to `scale`, by largest remainders, the riskier first."""
    share = values / values.sum(axis=1, keepdims=True) * scale
    whole = np.floor(share).astype(np.int64)
    missing = scale - whole.sum(axis=1)
    by_risk = np.round(whole - share, REMAINDER_DIGITS)[:, ::-1]
    rank = np.argsort(
        np.argsort(by_risk, axis=1, kind="stable"), axis=1, kind="stable"
    )[:, ::-1]
    return whole + (rank < missing[:, None])


def add_forest(
    graph: GraphBuilder, forest: Forest, features: str, n_classes: int, out: str
) -> str:
    """Add the trees; returns votes [B, n_classes] float32 that hold exact integers."""
    attributes = _tree_attributes(forest)
    votes = leaf_votes(forest, n_classes)
    leaf = np.array([mode == "LEAF" for mode in attributes["nodes_modes"]])
    trees, nodes = (
        np.array(attributes["nodes_treeids"]),
        np.array(attributes["nodes_nodeids"]),
    )
    stacked = np.concatenate(votes)
    rows, targets = np.nonzero(stacked * leaf[:, None])
    return graph.node(
        "TreeEnsembleRegressor",
        features,
        out=out,
        domain="ai.onnx.ml",
        n_targets=n_classes,
        aggregate_function="SUM",
        post_transform="NONE",
        target_ids=targets.tolist(),
        target_treeids=trees[rows].tolist(),
        target_nodeids=nodes[rows].tolist(),
        target_weights=stacked[rows, targets].astype(float).tolist(),
        **attributes,
    )


def _tree_attributes(forest: Forest) -> dict[str, Any]:
    """The trees as skl2onnx writes them; node ids are scikit-learn's own, which is checked."""
    from skl2onnx.common.tree_ensemble import (  # not needed to run or score a model file
        add_tree_to_attribute_pairs,
        get_default_tree_classifier_attribute_pairs,
    )

    attributes = get_default_tree_classifier_attribute_pairs()
    for number, tree in enumerate(forest.estimators_):
        add_tree_to_attribute_pairs(
            attributes,
            True,
            _plain(tree.tree_),
            number,
            tree_weight=1.0,
            weight_id_bias=0,
            leaf_weights_are_counts=False,
            adjust_threshold_for_sklearn=True,
            dtype=np.float32,
        )
    expected = np.concatenate(
        [np.arange(tree.tree_.node_count) for tree in forest.estimators_]
    )
    if not np.array_equal(expected, attributes["nodes_nodeids"]):
        raise AssertionError("skl2onnx no longer numbers nodes as scikit-learn does")
    return {name: attributes[name] for name in NODE_ATTRIBUTES}


def _plain(tree: Any) -> SimpleNamespace:
    """A copy of a tree's columns: scikit-learn wraps an array again for every node that is read.

    Thresholds stay float64, because a plain number would be compared as float32. The values of the
    leaves are not read: votes replace them.
    """
    columns = {
        name: getattr(tree, name).tolist()
        for name in ("children_left", "children_right", "feature")
    }
    return SimpleNamespace(
        node_count=tree.node_count,
        threshold=np.array(tree.threshold),
        value=np.zeros((tree.node_count, 1)),
        **columns,
    )
