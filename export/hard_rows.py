"""Rows that are hard for a converted learner: on its steps, and at the edges of float32."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from export.learner import Learner, features_in, forest_of, network_of
from export.network import Network
from export.reference import FloatRows

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
        parts.append(step_rows(network, rows, seed))
    return np.concatenate(parts)


def step_rows(network: Network, rows: FloatRows, seed: int) -> FloatRows:
    """Rows in which some inputs are where rounding steps, or one float32 beside it."""
    rng = np.random.default_rng(seed)
    hard = rows[rng.integers(len(rows), size=STEP_ROWS)].copy()
    inputs, columns = network.inputs, rng.random(hard.shape) < STEP_SHARE
    half = np.floor(np.abs(inputs.gain) * rng.uniform(-1, 1, hard.shape)) + 0.5
    squashed = np.clip((half - inputs.offset) / inputs.gain, -0.999, 0.999)
    at = (squashed * inputs.knee / (1.0 - np.abs(squashed))).astype(np.float32)
    towards = rng.choice(np.array([-np.inf, 0.0, np.inf], np.float32), size=hard.shape)
    return np.where(columns, np.where(towards == 0.0, at, np.nextafter(at, towards)), hard)


def threshold_rows(forest: Any, rows: FloatRows, seed: int) -> FloatRows:
    """Rows that reach a node of a tree with its threshold, or one float32 step beside it.

    All thresholds get all three values equally often, or a random choice if there are too many for
    THRESHOLD_ROWS. Each row is a held-out one, changed only so far that it reaches its node.
    """
    rng = np.random.default_rng(seed)
    trees = [_Branches(tree.tree_) for tree in forest.estimators_]
    places = [(tree, node) for tree in trees for node in tree.nodes]
    if not places:
        return rows[:0]
    chosen = np.resize(rng.permutation(3 * len(places)), THRESHOLD_ROWS).tolist()
    hard = rows[rng.integers(len(rows), size=THRESHOLD_ROWS)].copy()
    for row, (place, side) in zip(hard, (divmod(number, 3) for number in chosen), strict=True):
        tree, node = places[place]
        tree.lead(row, node)
        row[tree.feature[node]] = tree.beside[side][node]
    return hard


def largest_float32_not_above(threshold: npt.NDArray[np.float64]) -> FloatRows:
    """A float64 threshold for float32 rows: the largest float32 that still goes left."""
    near = threshold.astype(np.float32)
    return np.where(near > threshold, np.nextafter(near, np.float32(-np.inf)), near)


class _Branches:
    """A tree's branches as lists, because Python walks them one by one.

    beside: for each node the largest float32 that goes left, the one below it, and the one above
    it, which goes right.
    """

    def __init__(self, tree: Any) -> None:
        at = largest_float32_not_above(tree.threshold)
        around = (at, np.nextafter(at, np.float32(-np.inf)), np.nextafter(at, np.float32(np.inf)))
        self.beside = [side.tolist() for side in around]
        self.feature = tree.feature.tolist()
        self.nodes = [node for node, feature in enumerate(self.feature) if feature >= 0]
        left, right = tree.children_left.tolist(), tree.children_right.tolist()
        self._above = {left[node]: (node, True) for node in self.nodes}
        self._above |= {right[node]: (node, False) for node in self.nodes}

    def lead(self, row: npt.NDArray[np.float32], node: int) -> None:
        """Change a row [F] in place where it leaves the path to a node, from the root on down."""
        path = []
        while node in self._above:
            node, left = self._above[node]
            path.append((node, left))
        for above, left in reversed(path):
            feature, at = self.feature[above], self.beside[0][above]
            if (row[feature] <= at) != left:
                row[feature] = at if left else self.beside[2][above]


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
