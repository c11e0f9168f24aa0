"""Forests of many sizes for the price of the largest: its first trees are the smaller ones."""

from __future__ import annotations

from copy import copy
from dataclasses import replace

import numpy as np
import numpy.typing as npt

from export.forest import Forest
from training.crossval import fit_learner
from training.featurise import FloatRows
from training.plan import TrainingPlan
from training.recording import DataSet


class Grown:
    """Forests of up to n_trees that differ in their number only; fit is as fit_learner, seed 0."""

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
    ) -> Forest:
        """The plan's forest on these rows."""
        key = rows.tobytes()
        if key not in self._largest:
            largest = replace(plan, situation=replace(plan.situation, n_estimators=self._n_trees))
            self._largest[key] = fit_learner(data, features, largest, task, rows, 0)
        return first_trees(self._largest[key], plan.situation.n_estimators)


def first_trees(forest: Forest, n_trees: int) -> Forest:
    """The forest that a fit of so many trees would have been."""
    smaller = copy(forest).set_params(n_estimators=n_trees)
    smaller.estimators_ = forest.estimators_[:n_trees]
    return smaller
