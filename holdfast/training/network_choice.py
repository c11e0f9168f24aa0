"""A network's hyperparameters, chosen on folds of the training groups alone."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from sklearn.metrics import average_precision_score

from holdfast.training.network_fit import NetworkPlan, Reals, Rows, fit_members
from holdfast.training.splits import grouped_folds

FACTORS = ((1.0, 1), (0.1, 1), (10.0, 1), (1.0, 2))
"""On a plan's alpha and epochs; the first is the plan itself, which wins a tie."""


def candidates_of(plan: NetworkPlan) -> list[NetworkPlan]:
    """The plan and the plans beside it."""
    return [
        replace(plan, alpha=plan.alpha * alpha, epochs=plan.epochs * epochs)
        for alpha, epochs in FACTORS
    ]


def choose_network(
    plan: NetworkPlan,
    rows: Rows,
    label: npt.NDArray[np.int64],
    groups: npt.ArrayLike,
    n_folds: int,
    seed: int,
) -> NetworkPlan:
    """The candidate that ranks the windows of groups held out best: mean average precision.

    rows [N, F], label [N], groups [N]: of training. One network stands for a plan's members.
    Raises TooFewGroups.
    """
    candidates, n_classes = candidates_of(plan), int(label.max()) + 1
    shares = np.zeros((len(candidates), len(label), n_classes))
    for train, test in grouped_folds(groups, n_folds, seed=seed):
        for k, candidate in enumerate(candidates):
            alone = fit_members(
                replace(candidate, members=1), rows[train], label[train], seed
            )
            shares[k, test] = alone.shares(rows[test], n_classes)
    return candidates[int(np.argmax([_mean_precision(one, label) for one in shares]))]


def _mean_precision(shares: Reals, label: npt.NDArray[np.int64]) -> float:
    """Mean over the classes; of two classes, that of the second."""
    present = np.unique(label)
    asked = present[-1:] if shares.shape[1] == 2 else present
    return float(
        np.mean([average_precision_score(label == k, shares[:, k]) for k in asked])
    )
