"""What is chosen on folds of the training groups alone: label weights, and a network's parameters.

A label weight is what each situation's votes count for the label, chosen for macro F1.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import numpy.typing as npt
from sklearn.metrics import average_precision_score

from holdfast.core.contract import SITUATIONS, FloatArray, IntArray
from holdfast.export.heads import FloatRows, riskier_argmax
from holdfast.training.network_fit import fit_members
from holdfast.training.plan import NetworkPlan
from holdfast.training.recording import grouped_folds

WEIGHT_FACTORS = np.exp(np.linspace(-1.2, 1.2, 13)).tolist()
"""What a weight is multiplied by in a round of the search."""
ROUNDS = 2
"""Passes over all weights: the best value of one depends on the others."""
DIGITS = 4
"""Of a weight in the file."""
NETWORK_FACTORS = ((1.0, 1), (0.1, 1), (10.0, 1), (1.0, 2))
"""On a plan's alpha and epochs; the first is the plan itself, which wins a tie."""
LabelWeights = tuple[float, ...]


def fit_label_weights(votes: IntArray, situation: IntArray) -> LabelWeights:
    """Weights [4], the largest 1, from votes [M, 4] and true situations [M].

    The weights are searched in turn. A situation that is not in the truth keeps its weight.
    """
    shares = votes / votes.sum(axis=1, keepdims=True)

    # The search starts from equal weights, under which the label is the one with most votes.
    weights = np.ones(len(SITUATIONS))
    present = np.unique(situation).tolist()

    for _ in range(ROUNDS):
        for k in present:
            candidates = []
            scores = []
            for factor in WEIGHT_FACTORS:
                candidate = weights.copy()
                candidate[k] *= factor
                candidates.append(candidate)

                score = _macro_f1(shares * candidate, situation, present)
                scores.append(score)

            # Of equal scores argmax takes the first, the smaller weight.
            best = int(np.argmax(scores))
            weights = candidates[best]

    # Only their ratios count.
    scaled = weights / weights.max()
    return tuple(np.round(scaled, DIGITS).tolist())


def _macro_f1(scores: FloatArray, situation: IntArray, present: list[int]) -> float:
    """Mean F1 of the situations in the truth.

    Counted here and not by scikit-learn: the search asks for it about a hundred times a fold.
    """
    n = len(SITUATIONS)
    answer = riskier_argmax(scores)

    confusion = np.bincount(situation * n + answer, minlength=n * n).reshape(n, n)
    right = np.diag(confusion)

    # F1 = 2 right / (predicted + true); the bound keeps an absent situation from 0 / 0.
    predicted_and_true = confusion.sum(axis=0) + confusion.sum(axis=1)
    f1 = 2 * right / np.maximum(predicted_and_true, 1)
    return float(f1[present].mean())


def candidates_of(plan: NetworkPlan) -> list[NetworkPlan]:
    """The plan and its neighbours."""
    plans = []
    for alpha_factor, epochs_factor in NETWORK_FACTORS:
        alpha = plan.alpha * alpha_factor
        epochs = plan.epochs * epochs_factor
        plans.append(replace(plan, alpha=alpha, epochs=epochs))
    return plans


def choose_network(
    plan: NetworkPlan,
    rows: FloatRows,
    label: IntArray,
    groups: npt.ArrayLike,
    n_folds: int,
    seed: int,
) -> NetworkPlan:
    """The candidate that ranks the windows of groups held out best: mean average precision.

    rows [N, F], label [N], groups [N]: of training. One network stands for a plan's members.
    Raises TooFewGroups.
    """
    candidates = candidates_of(plan)

    folds = grouped_folds(groups, n_folds, seed=seed)
    n_classes = int(label.max()) + 1

    precisions = []
    for candidate in candidates:
        # The members differ in their seed alone, and four would take four times as long.
        single = replace(candidate, members=1)
        shares = np.zeros((len(label), n_classes))
        for train, test in folds:
            members = fit_members(single, rows[train], label[train], seed)
            shares[test] = members.shares(rows[test], n_classes)
        precisions.append(_mean_precision(shares, label))

    best = int(np.argmax(precisions))
    return candidates[best]


def _mean_precision(shares: FloatArray, label: IntArray) -> float:
    """Mean over the classes; of two classes, that of the second."""
    classes = np.unique(label)

    # The two shares add up to 1, so the first class would give the same ranking from its other end.
    if shares.shape[1] == 2:
        classes = classes[-1:]

    precisions = []
    for k in classes:
        precision = average_precision_score(label == k, shares[:, k])
        precisions.append(precision)
    return float(np.mean(precisions))
