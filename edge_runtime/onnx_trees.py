"""The trees of a TreeEnsembleRegressor: every walk ends in a leaf, and every leaf gives the same
number of votes.

onnxruntime follows whatever children a node names and reads whatever feature it names: trees that
loop never end, and a feature outside of the row is memory that is not ours. So it is proved for all
trees before they are opened, whatever row is fed later: the votes of a sample are whole numbers,
and their sum is trees x 2^vote_bits.
"""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_runtime.onnx_bytes import Node
from edge_runtime.protobuf import IntArray

MOST_DEPTH = 1000
"""onnxruntime calls itself once a level when it reads a tree."""
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
    """Raise ValueError where a walk could leave the trees or the row, or a leaf's votes are not
    2^vote_bits."""
    _require_settings(node, n_targets)
    tree, number, feature, below, otherwise = (_column(node, name, np.int64) for name in NODES)
    branch, threshold = (
        _column(node, "nodes_modes", np.bool_),
        _column(node, "nodes_values", np.float32),
    )
    if len(
        {len(one) for one in (tree, number, feature, below, otherwise, branch, threshold)}
    ) != 1 or not len(tree):
        raise ValueError("its trees' columns are not of one length")
    starts = _starts(tree, number, n_trees)
    if (feature >= n_features).any():
        raise ValueError("a tree asks for a feature that is not there")
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
    """[trees + 1] where each tree's nodes begin; trees and nodes are numbered from 0 on, in
    order."""
    at = np.arange(len(tree))
    starts = np.flatnonzero(number == 0)
    fits = len(starts) == n_trees and tree[0] == 0 and starts[0] == 0
    if (
        not fits
        or (np.diff(tree) != (number[1:] == 0)).any()
        or (number != at - starts[tree]).any()
    ):
        raise ValueError("its trees are not numbered in order, or not as many as its card says")
    return np.append(starts, len(tree))


def _require_ends(
    children: IntArray, starts: IntArray, tree: IntArray, branch: npt.NDArray[np.bool_]
) -> None:
    """Every node but a root has one parent, before it in the same tree, so no walk comes to a node
    twice."""
    behind = (children > np.arange(len(branch))) & (children < starts[tree + 1])
    if not (behind | ~branch).all():
        raise ValueError("a tree names a child that is not behind it, so a walk may never end")
    left, right = np.where(branch, children, 0)
    parents = np.bincount(left, minlength=len(branch)) + np.bincount(right, minlength=len(branch))
    parents[starts[:-1]] += 1
    if (parents[1:] != 1).any():
        raise ValueError("a tree's node has not one parent")
    _require_depth(left, right, starts[:-1])


def _require_depth(left: IntArray, right: IntArray, level: IntArray) -> None:
    """Level by level from the roots; at each level only the nodes of that level. Leaves have the
    child 0."""
    for _ in range(MOST_DEPTH):
        level = np.concatenate([left[level], right[level]])
        level = level[level > 0]
        if not len(level):
            return
    raise ValueError(f"a tree is deeper than {MOST_DEPTH}")


def _require_votes(
    node: Node, starts: IntArray, branch: npt.NDArray[np.bool_], n_targets: int, votes_a_leaf: int
) -> None:
    tree, number, target = (_column(node, name, np.int64) for name in TARGETS)
    weights = _column(node, "target_weights", np.float32).astype(np.float64)
    if not len(tree) == len(number) == len(target) == len(weights):
        raise ValueError("its votes' columns are not of one length")
    n_trees = len(starts) - 1
    if (tree >= n_trees).any() or (number >= np.diff(starts)[np.minimum(tree, n_trees - 1)]).any():
        raise ValueError("a vote is for a node that is not there")
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
