"""The same trees walked by a few lines of C: the limit of any runtime for one row."""

from __future__ import annotations

import ctypes
import shutil
import subprocess
from collections.abc import Callable
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import LibraryMissing
from holdfast.export.learner import Forest, leaf_votes
from holdfast.training.featurise import FloatRows

SOURCE = """
#include <stdint.h>
void votes(const float *row, const int32_t *roots, int32_t trees, const int32_t *feature,
           const float *threshold, const int32_t *left, const int32_t *right, const int32_t *leaf,
           int32_t classes, int32_t *out)
{
    for (int32_t k = 0; k < classes; k++) out[k] = 0;
    for (int32_t t = 0; t < trees; t++) {
        int32_t n = roots[t];
        while (feature[n] >= 0) n = row[feature[n]] <= threshold[n] ? left[n] : right[n];
        for (int32_t k = 0; k < classes; k++) out[k] += leaf[n * classes + k];
    }
}
"""


def c_walk(
    forest: Forest, n_classes: int, rows: FloatRows, work: Path
) -> Callable[[int], npt.NDArray[np.int32]]:
    """Votes in C on a row by its number; the next call overwrites them. Raises LibraryMissing."""
    library = ctypes.CDLL(str(_compiled(work)))
    trees = [tree.tree_ for tree in forest.estimators_]
    sizes = np.array([tree.node_count for tree in trees])

    # All trees stand in one table; each begins where the one before ends.
    roots = (np.cumsum(sizes) - sizes).astype(np.int32)
    features = []
    thresholds = []
    lefts = []
    rights = []
    for tree, root in zip(trees, roots, strict=True):
        # A leaf has no feature; children are numbered from the first node of all trees.
        is_leaf = tree.children_left < 0
        features.append(np.where(is_leaf, -1, tree.feature))
        thresholds.append(_lowered(tree.threshold))
        lefts.append(tree.children_left + root)
        rights.append(tree.children_right + root)

    arrays = [
        roots,
        np.concatenate(features).astype(np.int32),
        np.concatenate(thresholds),
        np.concatenate(lefts).astype(np.int32),
        np.concatenate(rights).astype(np.int32),
        np.concatenate(leaf_votes(forest, n_classes)).astype(np.int32),
    ]

    out = np.zeros(n_classes, dtype=np.int32)
    kept = np.ascontiguousarray(rows)
    tables = [ctypes.c_void_p(array.ctypes.data) for array in arrays]
    # All arguments are made beforehand, so that a call times the walk and not ctypes.
    pointers = []
    for k in range(len(kept)):
        address = kept.ctypes.data + k * kept.strides[0]
        pointers.append(ctypes.c_void_p(address))

    rest = (
        tables[0],
        ctypes.c_int32(len(roots)),
        *tables[1:],
        ctypes.c_int32(n_classes),
        ctypes.c_void_p(out.ctypes.data),
    )

    # The default argument keeps alive the arrays that C knows by their addresses only.
    def call(row: int, _keep: object = (arrays, kept)) -> npt.NDArray[np.int32]:
        library.votes(pointers[row], *rest)
        return out

    return call


def _lowered(threshold: npt.NDArray[np.float64]) -> npt.NDArray[np.float32]:
    """Largest float32 that is not above: x <= threshold says the same of every float32 x."""
    # scikit-learn compares a float32 with a float64; C shall compare two float32.
    near = threshold.astype(np.float32)
    below = np.nextafter(near, np.float32(-np.inf))
    return np.where(near > threshold, below, near)


def _compiled(work: Path) -> Path:
    compiler = shutil.which("cc")
    if compiler is None:
        raise LibraryMissing(
            "no C compiler", where="cc", next_step="install gcc to have this row"
        )

    source = work / "walk.c"
    library = work / "walk.so"
    source.write_text(SOURCE, encoding="utf-8")
    # For this very machine: the walk shall be as fast as it can be here.
    options = ["-O3", "-march=native", "-shared", "-fPIC"]
    subprocess.run([compiler, *options, "-o", library, source], check=True)
    return library
