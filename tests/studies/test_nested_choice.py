"""Nested choice: the people that are scored have no part in what is chosen for them."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest

from holdfast.core.contract import SITUATIONS as NAMES
from holdfast.data.recording import DataSet, LabelledRows, Recording
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.crossval import features_of, spec_for, splits_of
from holdfast.training.plan import ForestPlan, NetworkPlan, TrainingPlan
from studies.real.nested_choice import (
    PREDICTION,
    SITUATIONS,
    Candidate,
    FoldChoice,
    chosen_fold,
    figures_of,
)

PEOPLE, SAMPLES, RATE_HZ = 4, 400, 50.0
NETWORK = NetworkPlan(hidden=(8,), members=2, epochs=2, batch=64)
TREES = ForestPlan(n_estimators=4, max_depth=5)
SMALL = replace(
    TrainingPlan(learner="committee"),
    folds=2,
    groups=("now",),
    situation=TREES,
    prediction=TREES,
    network=NETWORK,
    prediction_network=NETWORK,
)


def made_up() -> DataSet:
    """Six sensors whose every channel says the situation, beneath noise; slips are rare."""
    rng = np.random.default_rng(0)
    recordings, labels = [], []
    for person in range(PEOPLE):
        label = np.repeat(rng.choice(4, SAMPLES // 20, p=[0.3, 0.4, 0.2, 0.1]), 20)
        label[:80] = np.repeat(np.arange(4), 20)
        values = rng.normal(2.0, 0.4, (SAMPLES, 18))
        values += 0.5 * label[:, None]
        valid = np.ones((SAMPLES, 6), np.bool_)
        name = f"p{person}"
        recordings.append(Recording(name, name, values, valid, RATE_HZ, "N"))
        labels.append(label)
    kept = np.arange(30, SAMPLES)
    trial, row = np.repeat(np.arange(PEOPLE), len(kept)), np.tile(kept, PEOPLE)
    label = np.concatenate([one[kept] for one in labels]).astype(np.int64)
    tasks = {
        "situations": LabelledRows(trial, row, label, NAMES),
        "predict_250ms": LabelledRows(
            trial, row, (label == 3).astype(np.int64), ("no", "yes")
        ),
    }
    return DataSet(
        "made up", recordings, tasks, RATE_HZ, "N", Preparation(), "made up", True, ""
    )


GOOD, BLIND = "says it", "says nothing"


def considered(data: DataSet) -> dict[str, Candidate]:
    """One set of features that says the situation, and one that is the same for all."""
    features = features_of(data, spec_for(data, SMALL.groups))
    nothing = {task: np.zeros_like(rows) for task, rows in features.items()}
    return {
        BLIND: Candidate(data, nothing, SMALL),
        GOOD: Candidate(data, features, SMALL),
    }


def choose(data: DataSet, of: dict[str, Candidate]) -> list[FoldChoice]:
    splits = splits_of(data, SMALL, 0)
    return [chosen_fold(of, split, 0) for split in splits]


@pytest.fixture(scope="module")
def data() -> DataSet:
    return made_up()


@pytest.fixture(scope="module")
def folds(data: DataSet) -> list[FoldChoice]:
    return choose(data, considered(data))


def test_each_fold_chooses_what_tells_most_and_its_people_are_answered_by_it(
    data: DataSet, folds: list[FoldChoice]
) -> None:
    splits = splits_of(data, SMALL, 0)
    figures = figures_of(data, splits, [asdict(fold) for fold in folds])
    assert {fold.method for fold in folds} == {GOOD}
    assert sum(figures["chosen"].values()) == SMALL.folds
    assert figures["row"]["situations"]["macro_f1"] > 0.4
    assert figures["row"]["predict_250ms"]["auc"] > 0.6


def test_labels_of_the_scored_people_change_no_choice_and_no_answer(
    data: DataSet, folds: list[FoldChoice]
) -> None:
    split = splits_of(data, SMALL, 0)[0]
    tasks = dict(data.tasks)
    for task in (SITUATIONS, PREDICTION):
        rows = tasks[task]
        label = rows.label.copy()
        label[split[task][1]] = 0
        tasks[task] = replace(rows, label=label)
    other = replace(data, tasks=tasks)
    again = chosen_fold(considered(other), split, 0)
    assert again == folds[0]
