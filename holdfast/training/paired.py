"""What one answer gains over another at the same windows, with intervals over the same draws.

Two answers to the same people go up and down together, so the interval of their difference is much
narrower than the difference of their intervals suggests.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, FloatArray
from holdfast.training.figures import Interval
from holdfast.training.metrics import (
    N_DRAWS,
    Labels,
    f1_and_draws,
    interval_of,
    macro,
    prediction_scores,
    ranking_draws,
)


@dataclass(frozen=True)
class Gain:
    """A difference of two figures and its 95 % interval; None where one is not defined."""

    value: float | None
    ci: Interval | None


def macro_f1_gain(
    truth: Labels,
    ours: Labels,
    theirs: Labels,
    groups: npt.ArrayLike,
    *,
    n_draws: int = N_DRAWS,
    seed: int = 0,
) -> Gain:
    """What our labels [M] gain over theirs, groups [M]."""
    n = len(SITUATIONS)
    found = [
        f1_and_draws(truth, one, groups, n, n_draws, seed) for one in (ours, theirs)
    ]
    (our_f1, our_draws), (their_f1, their_draws) = found
    draws = np.atleast_1d(macro(our_draws)) - np.atleast_1d(macro(their_draws))
    return _gain(float(macro(our_f1) - macro(their_f1)), draws)


def prediction_gains(
    truth: Labels,
    ours: FloatArray,
    theirs: FloatArray,
    groups: npt.ArrayLike,
    *,
    n_draws: int = N_DRAWS,
    seed: int = 0,
) -> tuple[Gain, Gain]:
    """What our scores [M] gain over theirs in AUC and in average precision."""
    figures = [
        prediction_scores(truth, one, groups, n_draws=0) for one in (ours, theirs)
    ]
    points = np.array(
        [[one.auc, one.average_precision] for one in figures], dtype=np.float64
    )
    both = [ranking_draws(truth, one, groups, n_draws, seed) for one in (ours, theirs)]
    auc, precision = points[0] - points[1]
    draws = both[0] - both[1]
    return _gain(float(auc), draws[:, 0]), _gain(float(precision), draws[:, 1])


def _gain(value: float, draws: FloatArray) -> Gain:
    return Gain(value if np.isfinite(value) else None, interval_of(draws))
