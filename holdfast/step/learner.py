"""What answers in a file: a forest, a network, or both as a committee; each votes in whole numbers.

Leaf probabilities of a forest are quantised to integers that sum to 2^k in every leaf, with
trees x 2^k < 2^24, so float32 adds them exactly and a batch equals a single row. skl2onnx converts
the trees (it rounds float64 thresholds down to float32 correctly); only the weights of the leaves
are ours. Ties go to the riskier class: classes are ordered by risk, and the last of equal ones
wins. In a committee, forest and network have the same number of votes.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from types import SimpleNamespace
from typing import Any, TypeAlias

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import ExtraTreesClassifier, RandomForestClassifier

from holdfast.core.errors import NotANumber
from holdfast.step.builder import GraphBuilder
from holdfast.step.network import (
    EXACT_FLOAT32,
    Float32Array,
    IntArray,
    Network,
    add_network,
    network_votes,
)

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
    "nodes_missing_value_tracks_true",
)
"""Columns that are taken from skl2onnx; the votes of the leaves are written by `add_forest`."""
ROWS_AT_ONCE = 8192
"""So many stay in the processor's caches; a long stream at once takes twice as long."""
FOREST_KINDS = (RandomForestClassifier, ExtraTreesClassifier)
Forest: TypeAlias = RandomForestClassifier | ExtraTreesClassifier


def vote_bits(n_trees: int) -> int:
    """Largest k with trees x 2^k < 2^24, at most 16."""
    # one less than the exact logarithm rounded up, because the sum must stay below 2^24
    return min(16, math.ceil(math.log2(EXACT_FLOAT32 / n_trees)) - 1)


def votes_of_trees(n_trees: int) -> int:
    """The sum of a row's votes."""
    return n_trees << vote_bits(n_trees)


@dataclass(frozen=True)
class Learner:
    """Trees, a network, or both as a committee.

    Raises ValueError for none, and for a committee whose votes differ in number, or are too many to
    add exactly.
    """

    forest: Forest | None = None
    network: Network | None = None

    def __post_init__(self) -> None:
        votes = self.votes_of_parts()
        if len(set(votes)) != 1 or sum(votes) >= EXACT_FLOAT32:
            raise ValueError(f"a learner of parts with {votes} votes")

    def votes_of_parts(self) -> list[int]:
        """The sum of a row's votes, for each part: trees, then network."""
        votes = []
        if self.forest is not None:
            votes.append(votes_of_trees(len(self.forest.estimators_)))
        if self.network is not None:
            votes.append(self.network.votes_in_all)
        return votes

    @property
    def n_features(self) -> int:
        """The number of features, F."""
        if self.network is not None:
            return self.network.n_features
        assert self.forest is not None
        return int(self.forest.n_features_in_)


def votes_in_all(learner: Learner) -> int:
    """The sum of a row's votes."""
    return sum(learner.votes_of_parts())


def reference_votes(
    learner: Learner, features: Float32Array, n_classes: int
) -> IntArray:
    """Exact integer votes [N, n_classes] of float32 rows [N, F]. Raises NotANumber."""
    rows = np.asarray(features, dtype=np.float32)
    if not np.isfinite(rows).all():
        raise NotANumber("features that are not finite", where="feature rows")
    total = np.zeros((len(rows), n_classes), dtype=np.int64)
    if learner.forest is not None:
        total += forest_votes(learner.forest, rows, n_classes)
    if learner.network is not None:
        total += network_votes(learner.network, rows)
    return total


def forest_votes(
    forest: Forest, rows: npt.NDArray[np.float32], n_classes: int
) -> IntArray:
    """Exact integer votes [N, n_classes] of float32 rows [N, F]: the reference for the graph."""
    total = np.zeros((len(rows), n_classes), dtype=np.int64)
    votes_by_tree = leaf_votes(forest, n_classes)

    # rows outside, trees inside: all trees see the same rows while they are in the cache
    for start in range(0, len(rows), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        for tree, votes in zip(forest.estimators_, votes_by_tree, strict=True):
            leaves = tree.tree_.apply(rows[some])
            total[some] += votes[leaves]

    return total


def leaf_votes(forest: Forest, n_classes: int) -> list[IntArray]:
    """Integer votes [nodes, n_classes] of every tree; each leaf's sum to 2^k (largest remainder).

    The forest's classes_ are columns of the n_classes; a class it never saw has no votes.
    """
    scale = 1 << vote_bits(len(forest.estimators_))
    columns = np.asarray(forest.classes_, dtype=np.int64)
    votes = []
    for tree in forest.estimators_:
        # [nodes, outputs, classes]; a forest of situations has one output
        weights = tree.tree_.value[:, 0, :]
        wide = np.zeros((tree.tree_.node_count, n_classes), dtype=np.int64)
        wide[:, columns] = _quantise(weights, scale)
        votes.append(wide)

    return votes


def _quantise(values: npt.NDArray[np.float64], scale: int) -> IntArray:
    """Rows of weights -> integers that sum to `scale`, by largest remainders, the riskier first."""
    share = values / values.sum(axis=1, keepdims=True) * scale
    whole = np.floor(share).astype(np.int64)
    missing = scale - whole.sum(axis=1)

    # Reversed columns and stable sorts: of equal remainders, the riskier class comes first.
    by_risk = np.round(whole - share, REMAINDER_DIGITS)[:, ::-1]
    # sorting the order again gives each class its rank
    order = np.argsort(by_risk, axis=1, kind="stable")
    rank = np.argsort(order, axis=1, kind="stable")[:, ::-1]
    return whole + (rank < missing[:, None])


def add_learner(
    graph: GraphBuilder,
    learner: Learner,
    features: str,
    n_classes: int,
    out: str,
    moved: Float32Array | None = None,
) -> str:
    """Add it to a graph; returns votes [B, n_classes] float32 that hold exact integers.

    moved: whole numbers [n_classes, n_classes] that the votes are multiplied by.
    """
    forest, network = learner.forest, learner.network
    if forest is None:
        assert network is not None
        return add_network(graph, network, features, moved, out)
    if network is None and moved is None:
        return add_forest(graph, forest, features, n_classes, out)
    trees = add_forest(graph, forest, features, n_classes, "")
    if network is None:
        return graph.node("MatMul", trees, np.asarray(moved), out=out)
    # both hold whole numbers below 2^23, so float32 adds them exactly
    added = add_network(graph, network, features, moved)
    if moved is None:
        return graph.node("Add", trees, added, out=out)
    return graph.node("Gemm", trees, moved, added, out=out)


def add_forest(
    graph: GraphBuilder, forest: Forest, features: str, n_classes: int, out: str
) -> str:
    """Add the trees; returns votes [B, n_classes] float32 that hold exact integers."""
    attributes = _tree_attributes(forest)
    trees = np.array(attributes["nodes_treeids"])
    nodes = np.array(attributes["nodes_nodeids"])
    is_leaf = np.array(attributes["nodes_modes"]) == "LEAF"

    # Votes of 0 are left out: they change no sum, and most leaves vote for few classes.
    votes = np.concatenate(leaf_votes(forest, n_classes))
    # scikit-learn keeps values at branches too; only those of leaves are votes
    rows, targets = np.nonzero(votes * is_leaf[:, None])
    weights = votes[rows, targets].astype(float)

    # a regressor, because a classifier of ONNX would normalise votes and choose a label itself
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
        target_weights=weights.tolist(),
        **attributes,
    )


def _tree_attributes(forest: Forest) -> dict[str, Any]:
    """The trees as skl2onnx writes them; node ids equal scikit-learn's, as structure.py checks."""
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
            # Thresholds are float64 and rows float32: rounded down, every row goes the same way.
            adjust_threshold_for_sklearn=True,
            dtype=np.float32,
        )
    turned = np.concatenate([_turned(tree.tree_) for tree in forest.estimators_])
    modes = np.where(turned, "BRANCH_GT", attributes["nodes_modes"])
    # NaN is not above, and goes right all the same
    of_nan = turned.astype(int).tolist()
    attributes.update(
        nodes_modes=modes.tolist(), nodes_missing_value_tracks_true=of_nan
    )
    return {name: attributes[name] for name in NODE_ATTRIBUTES}


def _turned(tree: Any) -> npt.NDArray[np.bool_]:
    """[nodes]: branches that ask for "above", because more rows of training went left.

    onnxruntime puts the false child next to its branch: so a walk reads fewer lines of memory that
    is not in the cache.
    """
    rows = tree.n_node_samples
    # at a leaf both children are -1
    return np.asarray(rows[tree.children_left] > rows[tree.children_right])


def _plain(tree: Any) -> SimpleNamespace:
    """A copy of a tree's columns: scikit-learn wraps an array again for every node that is read.

    Thresholds stay float64, because a plain number would be compared as float32. The values of the
    leaves are not read: votes replace them.
    """
    turned = _turned(tree)
    left, right = tree.children_left, tree.children_right
    return SimpleNamespace(
        node_count=tree.node_count,
        children_left=np.where(turned, right, left).tolist(),
        children_right=np.where(turned, left, right).tolist(),
        feature=tree.feature.tolist(),
        threshold=np.array(tree.threshold),
        value=np.zeros((tree.node_count, 1)),
    )
