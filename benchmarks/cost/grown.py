"""Forests of many sizes for the price of the largest: its first trees are the smaller ones.

A committee has such a forest, and a network fitted beside it.
"""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from holdfast.export.learner import Forest, Learner, forest_of
from holdfast.training.crossval import fit_learner, joined_by_network
from holdfast.training.featurise import FloatRows
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet


class Grown:
    """Learners whose forests, of up to n_trees, differ in their number only.

    fit is as fit_learner, seed 0.
    """

    def __init__(self, n_trees: int) -> None:
        self._n_trees = n_trees
        self._largest: dict[bytes, Forest] = {}

    def fit(
        self,
        data: DataSet,
        features: FloatRows,
        plan: TrainingPlan,
        task: str,
        rows: npt.NDArray[np.int64],
    ) -> Learner:
        """The plan's learner on these rows."""
        if plan.learner == "network":
            return fit_learner(data, features, plan, task, rows, 0)
        key = rows.tobytes()
        if key not in self._largest:
            situation = replace(plan.situation, n_estimators=self._n_trees)
            largest = replace(plan, learner="forest", situation=situation)
            forest = forest_of(fit_learner(data, features, largest, task, rows, 0))
            assert forest is not None
            self._largest[key] = forest
        forest = first_trees(self._largest[key], plan.situation.n_estimators)
        if plan.learner == "forest":
            return forest
        given = data.tasks[task]
        label, n_classes = given.label[rows], len(given.classes)
        return joined_by_network(
            forest, plan, task, features[rows], label, n_classes, 0
        )


def first_trees(forest: Forest, n_trees: int) -> Forest:
    """The forest that a fit of so many trees would have been."""
    smaller = copy(forest).set_params(n_estimators=n_trees)
    smaller.estimators_ = forest.estimators_[:n_trees]
    return smaller
