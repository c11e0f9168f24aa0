"""A way to answer windows: what it sees of them, and the forest that is fitted on it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

from holdfast.core.contract import CLASSES
from holdfast.export.learner import reference_votes
from holdfast.export.network import IntArray
from holdfast.training.crossval import fit_learner
from holdfast.training.featurise import FloatRows
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet


@dataclass(frozen=True)
class Candidate:
    """A way to answer: its plan, and what it sees of the windows of "classes" [M, F]."""

    plan: TrainingPlan
    features: Callable[[DataSet], FloatRows]

    def votes(
        self,
        data: DataSet,
        features: FloatRows,
        train: IntArray,
        rows: FloatRows,
        seed: int,
    ) -> IntArray:
        """Votes [K, 8] on rows [K, F] of a forest fitted on some windows of a set."""
        forest = fit_learner(data, features, self.plan, "classes", train, seed)
        return reference_votes(forest, rows, len(CLASSES))
