"""The raw forest with windows split at random: a warning of what a wrong test reports."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.export.heads import riskier_argmax
from holdfast.export.learner import Forest, reference_votes
from holdfast.export.network import IntArray
from holdfast.training.crossval import fit_learner
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.figures import HeadFigures
from holdfast.training.metrics import report
from holdfast.training.plan import RAW_BASELINE, TrainingPlan
from holdfast.training.recording import DataSet
from holdfast.training.splits import leaky_folds
from studies.row_names import LEAKY_FOLDS


def leaky(
    data: DataSet, plan: TrainingPlan = RAW_BASELINE, *, seed: int = 0
) -> HeadFigures:
    """Neighbouring windows stand on both sides of the split: wrong on purpose."""
    features = features_of(data, spec_for(data, plan.groups))
    votes = {
        task: _leaky_votes(data, features[task], plan, task, seed)
        for task in data.tasks
    }
    score: FloatArray = votes["predict_250ms"][:, 1].astype(np.float64)
    return report(data, riskier_argmax(votes["situations"]), score, seed=seed)


def _leaky_votes(
    data: DataSet, features: FloatRows, plan: TrainingPlan, task: str, seed: int
) -> IntArray:
    n_classes = len(data.tasks[task].classes)
    votes = np.zeros((len(features), n_classes), dtype=np.int64)
    for train, test in leaky_folds(len(features), LEAKY_FOLDS, seed=seed):
        forest: Forest = fit_learner(data, features, plan, task, train, seed)
        votes[test] = reference_votes(forest, features[test], n_classes)
    return votes
