"""The trees of a TreeEnsembleRegressor: every walk ends in a leaf, and all leaves give equal votes.

onnxruntime follows any child that a node names and reads any feature: trees with a loop never end,
and a feature outside the row is foreign memory. So this is proved for all trees before they are
opened, for any later row: the votes of a sample are whole numbers, and their sum is trees x
2^vote_bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.onnx_bytes import IntArray, Node

MOST_DEPTH = 1000
"""onnxruntime recurses once for each level when it reads a tree."""
EXACT_FLOAT32 = 2**24
NODES = (
    "nodes_treeids",
    "nodes_nodeids",
    "nodes_featureids",
    "nodes_truenodeids",
    "nodes_falsenodeids",
)
TARGETS = ("target_treeids", "target_nodeids", "target_ids")


def require_trees(
    node: Node, n_features: int, n_targets: int, n_trees: int, vote_bits: int
) -> None:
    """Raise ValueError where a walk could leave its tree or row, or a leaf's votes are wrong.

    A leaf must give 2^vote_bits votes.
    """
    _require_settings(node, n_targets)
    tree, number, feature, below, otherwise = (
        _column(node, name, np.int64) for name in NODES
    )
    branch = _column(node, "nodes_modes", np.bool_)
    threshold = _column(node, "nodes_values", np.float32)
    columns = (tree, number, feature, below, otherwise, branch, threshold)
    if len({len(column) for column in columns}) != 1 or not len(tree):
        raise ValueError("its trees' columns are not of one length")
    starts = _starts(tree, number, n_trees)
    if (feature >= n_features).any():
        raise ValueError("a tree uses a feature that does not exist")
    _require_ends(starts[tree] + np.array([below, otherwise]), starts, tree, branch)
    _require_votes(node, starts, branch, n_targets, 1 << vote_bits)
    if n_trees << vote_bits >= EXACT_FLOAT32:
        raise ValueError("its votes are too many for float32 to add exactly")


def _require_settings(node: Node, n_targets: int) -> None:
    settings = {
        name: node.attributes.get(name)
        for name in ("n_targets", "aggregate_function", "post_transform")
    }
    if settings != {
        "n_targets": n_targets,
        "aggregate_function": b"SUM",
        "post_transform": b"NONE",
    }:
        raise ValueError("its trees do not add up votes for the classes of its card")


def _column(node: Node, name: str, dtype: type[np.generic]) -> npt.NDArray[Any]:
    values = node.attributes.get(name)
    if not isinstance(values, np.ndarray) or values.dtype != dtype:
        raise ValueError(f"its trees have no {name}")
    return values


def _starts(tree: IntArray, number: IntArray, n_trees: int) -> IntArray:
    """[trees + 1] where each tree's nodes begin.

    Trees and nodes must be numbered from 0, in order.
    """
    at = np.arange(len(tree))
    starts = np.flatnonzero(number == 0)
    fits = len(starts) == n_trees and tree[0] == 0 and starts[0] == 0
    if (
        not fits
        or (np.diff(tree) != (number[1:] == 0)).any()
        or (number != at - starts[tree]).any()
    ):
        raise ValueError(
            "its trees are not numbered in order, or not as many as its card says"
        )
    return np.append(starts, len(tree))


def _require_ends(
    children: IntArray, starts: IntArray, tree: IntArray, branch: npt.NDArray[np.bool_]
) -> None:
    """Every node but a root has one parent, before it in its tree: no walk visits a node twice."""
    behind = (children > np.arange(len(branch))) & (children < starts[tree + 1])
    if not (behind | ~branch).all():
        raise ValueError(
            "a node's child does not come after it, so a walk may never end"
        )
    left, right = np.where(branch, children, 0)
    parents = np.bincount(left, minlength=len(branch)) + np.bincount(
        right, minlength=len(branch)
    )
    parents[starts[:-1]] += 1
    if (parents[1:] != 1).any():
        raise ValueError("a node of a tree has no parent, or several")
    _require_depth(left, right, starts[:-1])


def _require_depth(left: IntArray, right: IntArray, level: IntArray) -> None:
    """Level by level from the roots, only the nodes of that level. Leaves have the child 0."""
    for _ in range(MOST_DEPTH):
        level = np.concatenate([left[level], right[level]])
        level = level[level > 0]
        if not len(level):
            return
    raise ValueError(f"a tree is deeper than {MOST_DEPTH}")


def _require_votes(
    node: Node,
    starts: IntArray,
    branch: npt.NDArray[np.bool_],
    n_targets: int,
    votes_a_leaf: int,
) -> None:
    tree, number, target = (_column(node, name, np.int64) for name in TARGETS)
    weights = _column(node, "target_weights", np.float32).astype(np.float64)
    if not len(tree) == len(number) == len(target) == len(weights):
        raise ValueError("its votes' columns are not of one length")
    n_trees = len(starts) - 1
    if (tree >= n_trees).any() or (
        number >= np.diff(starts)[np.minimum(tree, n_trees - 1)]
    ).any():
        raise ValueError("a vote is for a node that does not exist")
    whole = (weights >= 0) & (weights == np.floor(weights))
    given = np.bincount(starts[tree] + number, weights, minlength=len(branch))
    if (
        (target >= n_targets).any()
        or not whole.all()
        or (given != np.where(branch, 0, votes_a_leaf)).any()
    ):
        raise ValueError(
            f"a leaf does not give {votes_a_leaf} whole votes to the classes of its card"
        )
