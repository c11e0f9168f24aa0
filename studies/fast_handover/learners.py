"""Learners: fitted on eight classes, they answer a situation and a share for risky slip."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Any, Protocol

import numpy as np
from sklearn.ensemble import HistGradientBoostingClassifier
from sklearn.utils.class_weight import compute_sample_weight
from threadpoolctl import threadpool_limits

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, SITUATIONS
from holdfast.export.heads import riskier_argmax, situation_votes
from holdfast.export.learner import reference_votes
from holdfast.export.network import IntArray
from holdfast.training.featurise import FloatRows
from holdfast.training.plan import ForestPlan

Answer = tuple[IntArray, IntArray]
"""[T] situation 0..3, and [T] thousandths for a risky slip."""


def answer_of(votes: IntArray) -> Answer:
    """The answer of votes [T, 8] or [T, 4]."""
    votes = situation_votes(votes)
    return riskier_argmax(votes), (1000 * votes[:, RISKY_SLIP]) // votes.sum(axis=1)


class Learner(Protocol):
    """Something that is fitted and answers.

    models: the fitted scikit-learn models, for timing; each runs once a sample.
    """

    models: Sequence[Any]

    def fit(self, features: FloatRows, label: IntArray, seed: int) -> None:
        """Fit on rows [M, F] with labels 0..7 [M]."""

    def answer(self, features: FloatRows) -> Answer:
        """The answers to rows [T, F]."""


@dataclass
class Forest:
    """A forest of a plan: of eight classes, or of four situations with weight as its own head."""

    plan: ForestPlan
    classes: int = 8
    risky_weight: float = 1.0

    def fit(self, features: FloatRows, label: IntArray, seed: int) -> None:
        """See Learner. risky_weight: factor on the weight of risky slips."""
        target = label if self.classes == 8 else label // 2
        weight = compute_sample_weight("balanced", target) * np.where(
            label // 2 == RISKY_SLIP, self.risky_weight, 1.0
        )
        unweighted = replace(self.plan, class_weight=None).build(seed)
        forest = unweighted.fit(features, target, sample_weight=weight)
        self.models: Sequence[Any] = [forest]

    def answer(self, features: FloatRows) -> Answer:
        """See Learner."""
        return answer_of(reference_votes(self.models[0], features, self.classes))


@dataclass
class TwoStages:
    """Two forests of a plan: whether something is held, then which situation."""

    plan: ForestPlan

    def fit(self, features: FloatRows, label: IntArray, seed: int) -> None:
        """See Learner."""
        held = label // 2 != NOTHING
        contact = self.plan.build(seed).fit(features, held.astype(np.int64))
        situation = self.plan.build(seed)
        situation.fit(features[held], label[held] // 2 - GRASP)
        self.models: Sequence[Any] = [contact, situation]

    def answer(self, features: FloatRows) -> Answer:
        """See Learner."""
        contact, of_held = self.models
        held = riskier_argmax(reference_votes(contact, features, 2)) == 1
        votes = reference_votes(of_held, features, len(SITUATIONS) - GRASP)
        situation = np.where(held, GRASP + riskier_argmax(votes), NOTHING)
        return situation, (1000 * votes[:, RISKY_SLIP - GRASP]) // votes.sum(axis=1)


@dataclass
class Boosting:
    """Histogram gradient boosting of four situations; it exports to a forest's operator."""

    iterations: int = 100
    leaves: int = 31
    bins: int = 255

    def fit(self, features: FloatRows, label: IntArray, seed: int) -> None:
        """See Learner."""
        model = HistGradientBoostingClassifier(
            max_bins=self.bins,
            max_iter=self.iterations,
            max_leaf_nodes=self.leaves,
            class_weight="balanced",
            early_stopping=False,
            random_state=seed,
        )
        # several threads wait for each other in busy loops when other work runs
        with threadpool_limits(1):
            self.models: Sequence[Any] = [model.fit(features, label // 2)]

    def answer(self, features: FloatRows) -> Answer:
        """See Learner."""
        with threadpool_limits(1):
            probability = self.models[0].predict_proba(features)
        permille = (1000 * probability[:, RISKY_SLIP]).astype(np.int64)
        return probability.argmax(axis=1).astype(np.int64), permille
