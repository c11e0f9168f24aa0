"""The reference for an exported file: scikit-learn's trees, quantised leaves, the tie rule."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from edge_runtime.contract import SITUATIONS, BoolArray, FloatArray
from edge_runtime.errors import NotANumber
from export.forest import Forest, IntArray, leaf_votes
from export.heads import Head
from export.spec import RANGE_LIMIT, StepSpec

FloatRows = npt.NDArray[np.float32]
ROWS_AT_ONCE = 8192
"""So many stay in the processor's caches; a long stream at once takes twice as long."""


def reference_votes(forest: Forest, features: FloatRows, n_classes: int) -> IntArray:
    """Exact integer votes [N, n_classes] of float32 rows [N, F]. Raises NotANumber."""
    total = np.zeros((len(features), n_classes), dtype=np.int64)
    trees = list(zip(forest.estimators_, leaf_votes(forest, n_classes), strict=True))
    for start in range(0, len(features), ROWS_AT_ONCE):
        some = slice(start, start + ROWS_AT_ONCE)
        rows = np.asarray(features[some], dtype=np.float32)
        if not np.isfinite(rows).all():
            what = f"a feature of rows {start} to {start + len(rows)} is not finite"
            raise NotANumber(what, where="feature rows")
        for tree, votes in trees:
            total[some] += votes[tree.tree_.apply(rows)]
    return total


def riskier_argmax(votes: IntArray) -> IntArray:
    """[N, K] votes -> [N] label: the largest; among equal ones the riskier (the last)."""
    k = votes.shape[1]
    return np.asarray(k - 1 - np.argmax(votes[:, ::-1], axis=1), dtype=np.int64)


def reference_probability(head: Head, votes: IntArray) -> npt.NDArray[np.float64]:
    """Calibrated probabilities [N, K] of exact votes [N, K], in float64."""
    shares = votes / votes.sum(axis=1, keepdims=True)
    logits = shares @ head.calibration.weights + head.calibration.bias
    raised = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=1, keepdims=True), dtype=np.float64)


def reference_heavy(votes: IntArray) -> npt.NDArray[np.bool_]:
    """[N, 8] votes -> [N]: at least as many for heavy as for light; "nothing" does not count."""
    contact = votes[:, 2:]
    return np.asarray(contact[:, 1::2].sum(axis=1) >= contact[:, 0::2].sum(axis=1), dtype=np.bool_)


def situation_votes(votes: IntArray) -> IntArray:
    """Votes for the four situations; of eight classes, light and heavy are added up."""
    return (
        votes if votes.shape[1] == len(SITUATIONS) else votes.reshape(len(votes), -1, 2).sum(axis=2)
    )


def reference_flags(
    values: FloatArray, valid: BoolArray, spec: StepSpec
) -> dict[str, npt.NDArray[Any]]:
    """settled, unknown and usable_sensors [T] by the guard's rule in plain Python, from fresh."""
    delivered, lost = np.zeros(spec.n_sensors, int), np.zeros(spec.n_sensors, int)
    flags: dict[str, list[Any]] = {"settled": [], "unknown": [], "usable_sensors": []}
    for row, delivers in zip(values.reshape(len(values), -1, 3), valid, strict=True):
        good = (
            delivers
            & np.isfinite(row).all(axis=1)
            & (np.abs(row) < RANGE_LIMIT[spec.unit]).all(axis=1)
        )
        lost = np.where(good, 0, lost + 1)
        delivered = np.where(good, delivered + 1, np.where(lost > spec.gap_samples, 0, delivered))
        settled = delivered >= spec.settle_samples
        usable = int((good & settled).sum())
        flags["settled"].append(int(settled.sum()) >= spec.min_valid_sensors)
        flags["unknown"].append(usable < spec.min_valid_sensors)
        flags["usable_sensors"].append(usable)
    return {name: np.array(column) for name, column in flags.items()}
