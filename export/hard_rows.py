"""Rows that are hard for a converted forest: on its thresholds, and at the edges of float32."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from export.reference import FloatRows

THRESHOLD_ROWS = 20_000


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


def edge_rows(forest: Any) -> FloatRows:
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
    return np.repeat(np.array(values, dtype=np.float32)[:, None], forest.n_features_in_, axis=1)
