"""A split that is wrong on purpose, to show how far it flatters."""

from __future__ import annotations

import numpy as np

from holdfast.data.recording import Fold


def leaky_folds(n_rows: int, n_folds: int, *, seed: int = 0) -> list[Fold]:
    """Folds of random windows, so that neighbours in time are on both sides: WRONG."""
    fold = np.random.default_rng(seed).permutation(n_rows) % n_folds
    return [
        (np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in range(n_folds)
    ]
