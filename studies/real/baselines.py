"""Baselines on human_slip_uskin: the raw forest, timing only, and a leaky split.

The last two are warnings. Timing alone shows how far the script of the protocol goes without any
sign of a slip; the leaky split shows what a wrong test reports.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.export.forest import Forest
from holdfast.export.learner import reference_votes
from holdfast.export.reference import IntArray, riskier_argmax
from holdfast.studies.row_names import LEAKY_FOLDS
from holdfast.training.crossval import cross_validate, fit_learner
from holdfast.training.datasets.human_slip_uskin import clock_features
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.figures import HeadFigures
from holdfast.training.fitting import held_out_figures
from holdfast.training.metrics import report
from holdfast.training.plan import CLOCK_PLAN, RAW_BASELINE, TrainingPlan
from holdfast.training.recording import DataSet
from holdfast.training.splits import leaky_folds

"""Fewer than the honest rows have: a warning need not take longer than what it warns of."""


def raw_forest(data: DataSet, *, folds: int = RAW_BASELINE.folds, seed: int = 0) -> HeadFigures:
    """The thesis' untuned forest on the raw window, people held out."""
    features = features_of(data, spec_for(data, RAW_BASELINE.groups))
    plan = replace(RAW_BASELINE, folds=folds)
    return held_out_figures(data, cross_validate(data, features, plan, seed=seed), seed)


def clock(all_channels: DataSet, *, seed: int = 0) -> HeadFigures:
    """Timing only: frames since contact and total force, people held out (needs 48 channels)."""
    features = {
        task: clock_features(all_channels, rows) for task, rows in all_channels.tasks.items()
    }
    narrow = {task: values.astype(np.float32) for task, values in features.items()}
    return held_out_figures(
        all_channels, cross_validate(all_channels, narrow, CLOCK_PLAN, seed=seed), seed
    )


def leaky(data: DataSet, *, seed: int = 0) -> HeadFigures:
    """The raw forest with windows split at random, neighbours on both sides: wrong on purpose."""
    plan, features = RAW_BASELINE, features_of(data, spec_for(data, RAW_BASELINE.groups))
    votes = {task: _leaky_votes(data, features[task], plan, task, seed) for task in data.tasks}
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
