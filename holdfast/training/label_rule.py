"""What each situation's votes count for the label, chosen for macro F1 on held-out windows."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS
from holdfast.export.heads import riskier_argmax, weighted

FACTORS = np.exp(np.linspace(-1.2, 1.2, 13)).tolist()
"""What one weight is multiplied by in a round of the search."""
ROUNDS = 2
DIGITS = 4
LabelWeights = tuple[float, ...]


def fit_label_weights(
    votes: npt.NDArray[np.int64], situation: npt.NDArray[np.int64]
) -> LabelWeights:
    """Weights [4], the largest 1, from votes [M, 4] and true situations [M]: one after the other.

    A situation that is not in the truth keeps its weight.
    """
    shares = votes / votes.sum(axis=1, keepdims=True)
    weights = np.ones(len(SITUATIONS))
    present = np.unique(situation).tolist()
    for _ in range(ROUNDS):
        for k in present:
            candidates = [_scaled(weights, k, factor) for factor in FACTORS]
            scores = [_macro_f1(shares * one, situation, present) for one in candidates]
            weights = candidates[int(np.argmax(scores))]
    return tuple(np.round(weights / weights.max(), DIGITS).tolist())


def _scaled(
    weights: npt.NDArray[np.float64], k: int, factor: float
) -> npt.NDArray[np.float64]:
    scaled = weights.copy()
    scaled[k] *= factor
    return scaled


def _macro_f1(
    scores: npt.NDArray[np.float64],
    situation: npt.NDArray[np.int64],
    present: list[int],
) -> float:
    """Mean F1 of the situations in the truth."""
    n = len(SITUATIONS)
    cells = np.bincount(
        situation * n + riskier_argmax(scores), minlength=n * n
    ).reshape(n, n)
    f1 = 2 * np.diag(cells) / np.maximum(cells.sum(axis=0) + cells.sum(axis=1), 1)
    return float(f1[present].mean())


def situation_labels(
    votes: npt.NDArray[np.int64], weights: LabelWeights | None
) -> npt.NDArray[np.int64]:
    """[M] situations from situation votes [M, 4]; weights: None for the same for all."""
    return riskier_argmax(weighted(votes, weights))
