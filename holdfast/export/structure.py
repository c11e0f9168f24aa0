"""Hard rows for a converted learner, and a comparison of every number in it with training.

Hard rows lie on the learner's steps and at the edges of float32. Rows on a threshold can agree by
chance, where both sides of a branch vote alike; the numbers of the nodes cannot.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx
from onnx import helper

from holdfast.core.errors import VerificationFailed
from holdfast.step.heads import Correction, FloatRows, Head, learned_name
from holdfast.step.learner import Forest, Learner, leaf_votes
from holdfast.step.network import InputScale

THRESHOLD_ROWS, THRESHOLD_SHARE = 20_000, 0.9
"""Rows on thresholds of the trees, and the share of features that are moved there."""
STEP_ROWS, STEP_SHARE = 5_000, 0.2
"""Rows on the steps of a network's inputs, and the share of inputs that are moved there."""
DIFFER = "differ from training"


def hard_rows(learner: Learner, rows: FloatRows, seed: int) -> FloatRows:
    """Hard rows [H, F] for all that is in a learner."""
    parts = []
    if learner.forest is not None:
        parts.append(threshold_rows(learner.forest, rows, seed))
    parts.append(edge_rows(learner.n_features))
    if learner.network is not None:
        parts.append(step_rows(learner.network.inputs, rows, seed))
    return np.concatenate(parts)


def edge_rows(n_features: int) -> FloatRows:
    """Rows of zeros of both signs, subnormals, the smallest and the largest finite numbers."""
    limits = np.finfo(np.float32)
    subnormal = limits.smallest_subnormal
    values = [0.0, -0.0, subnormal, -subnormal, limits.tiny, limits.max, limits.min]
    column = np.array(values, dtype=np.float32)[:, None]
    return np.repeat(column, n_features, axis=1)


def hard_rows_of(correction: Correction | None, rows: FloatRows) -> FloatRows:
    """Hard rows [H, F] for a correction: at the edges of float32, and on its inputs' steps."""
    n = rows.shape[1]
    if correction is None:
        return edge_rows(n)

    # Of the correction's inputs, the first n are the features. Magnitudes and votes follow from
    # them, so only features can be moved to a step.
    inputs = correction.network.inputs
    features = InputScale(inputs.knee[:n], inputs.gain[:n], inputs.offset[:n])
    return np.concatenate([edge_rows(n), step_rows(features, rows, 0)])


def step_rows(inputs: InputScale, rows: FloatRows, seed: int) -> FloatRows:
    """Rows in which some inputs are where rounding steps, or at a neighbouring float32."""
    rng = np.random.default_rng(seed)
    hard = rows[rng.integers(len(rows), size=STEP_ROWS)]

    # q rounds gain * s + offset with s = x / (knee + |x|): solve for x where that is a half
    steps = np.abs(inputs.gain) * rng.uniform(-1, 1, hard.shape)
    half = np.floor(steps) + 0.5
    # s = +-1 is reached only at infinity
    squashed = np.clip((half - inputs.offset) / inputs.gain, -0.999, 0.999)
    exact = squashed * inputs.knee / (1.0 - np.abs(squashed))
    return _near_thresholds(hard, exact.astype(np.float32), STEP_SHARE, rng)


def threshold_rows(forest: Forest, rows: FloatRows, seed: int) -> FloatRows:
    """Rows in which most features are on a threshold of the trees, or at a neighbouring float32.

    The thresholds of a feature are drawn from all trees, so that a row meets some on its way.
    """
    rng = np.random.default_rng(seed)
    hard = rows[rng.integers(len(rows), size=THRESHOLD_ROWS)]
    # scikit-learn marks a leaf by the feature -2
    feature = _of_all_trees(forest, "feature")
    at = largest_float32_not_above(_of_all_trees(forest, "threshold"))
    # 0 for a feature that no tree reads
    on = np.zeros_like(hard)
    for column in np.unique(feature[feature >= 0]):
        on[:, column] = rng.choice(at[feature == column], THRESHOLD_ROWS)
    return _near_thresholds(hard, on, THRESHOLD_SHARE, rng)


def _near_thresholds(
    rows: FloatRows, to: FloatRows, share: float, rng: np.random.Generator
) -> FloatRows:
    """Rows with a share of their numbers moved: to the number itself, or its neighbour.

    Of a step and its neighbours on both sides, one must go the other way.
    """
    directions = np.array([-np.inf, 0.0, np.inf], np.float32)
    towards = rng.choice(directions, size=rows.shape)
    moved = np.where(towards == 0.0, to, np.nextafter(to, towards))
    return np.where(rng.random(rows.shape) < share, moved, rows)


def largest_float32_not_above(threshold: npt.NDArray[np.float64]) -> FloatRows:
    """A float64 threshold for float32 rows: the largest float32 that still goes left."""
    near = threshold.astype(np.float32)
    below = np.nextafter(near, np.float32(-np.inf))
    return np.where(near > threshold, below, near)


def require_same_numbers(model: onnx.ModelProto, head: Head) -> int:
    """Compare all numbers of a learner; returns how many nodes and weights it has.

    Raises VerificationFailed with the number of those that differ.
    """
    forest, network = head.learner.forest, head.learner.network
    count = 0
    if forest is not None:
        made_by = {node.output[0]: node for node in model.graph.node}
        # where force decides "nothing", the learner's votes are not yet those of the file
        trees = made_by.get(learned_name(head.votes_name)) or made_by[head.votes_name]
        # the votes of a committee are the sum of those of the trees and of the network
        while trees.op_type != "TreeEnsembleRegressor":
            trees = made_by[trees.input[0]]
        count += _same_trees(trees, forest, head)

    if network is None:
        return count
    # every matrix and every bias of the network is in the file, number by number: the builder
    # names constants by number, so they are looked up by what they hold
    constants = [onnx.numpy_helper.to_array(one) for one in model.graph.initializer]
    for layer in network.layers:
        for numbers in (layer.weights, layer.bias):
            is_there = any(np.array_equal(numbers, one) for one in constants)
            require(is_there, f"head {head.name}: {numbers.size} weights {DIFFER}")

    return count + network.n_weights


def _same_trees(node: onnx.NodeProto, forest: Forest, head: Head) -> int:
    """Features, thresholds, children and leaves."""
    exported = {one.name: helper.get_attribute_value(one) for one in node.attribute}
    threshold = _of_all_trees(forest, "threshold")
    expected = {
        "nodes_values": largest_float32_not_above(threshold),
        "nodes_featureids": _of_all_trees(forest, "feature"),
        "left": _of_all_trees(forest, "children_left"),
        "right": _of_all_trees(forest, "children_right"),
    }
    # Training decides what is a branch, so that a wrong mode in the file is found.
    branch = expected["nodes_featureids"] >= 0
    modes = np.array(exported["nodes_modes"])
    wrong = (modes != b"LEAF") != branch
    # where a branch asks for "above the threshold", its true child is the right one
    is_above = modes == b"BRANCH_GT"
    left = np.where(
        is_above, exported["nodes_falsenodeids"], exported["nodes_truenodeids"]
    )
    right = np.where(
        is_above, exported["nodes_truenodeids"], exported["nodes_falsenodeids"]
    )
    exported.update(left=left, right=right)

    # at a leaf, both sides hold fillers that no walk reads
    for name, numbers in expected.items():
        given = np.array(exported[name], dtype=numbers.dtype)
        wrong |= branch & (given != numbers)

    # Values that training keeps at branches are no votes: only a leaf may have any.
    expected_votes = np.concatenate(leaf_votes(forest, len(head.classes)))
    expected_votes[branch] = 0
    differs = votes_of_nodes(exported, len(head.classes)) != expected_votes
    wrong |= np.any(differs, axis=1)
    n_wrong = int(wrong.sum())
    require(not n_wrong, f"head {head.name}: {n_wrong} of {len(wrong)} nodes {DIFFER}")
    return len(wrong)


def _of_all_trees(forest: Forest, name: str) -> npt.NDArray[Any]:
    """An attribute of every node, tree after tree, as training left it."""
    trees = [getattr(tree.tree_, name) for tree in forest.estimators_]
    return np.concatenate(trees)


def votes_of_nodes(trees: Mapping[str, Any], n_classes: int) -> FloatRows:
    """[nodes, K] votes of every node of a file; a branch should have none.

    trees: attributes of a TreeEnsembleRegressor, by name.
    """
    # the ids of nodes count from each tree's first one, the rows here through all trees
    ids = np.array(trees["nodes_nodeids"])
    starts = np.flatnonzero(ids == 0)
    rows = starts[trees["target_treeids"]] + trees["target_nodeids"]
    votes = np.zeros((len(ids), n_classes), dtype=np.float32)
    # votes that are listed twice add up, as the runtime adds them
    np.add.at(votes, (rows, trees["target_ids"]), trees["target_weights"])
    return votes


def require(same: bool, otherwise: str) -> None:
    """Raise VerificationFailed with the text `otherwise` unless something is the same."""
    if not same:
        raise VerificationFailed(
            otherwise,
            cause="a converter or runtime that computes differently",
            next_step="report the versions that holdfast doctor prints",
        )
