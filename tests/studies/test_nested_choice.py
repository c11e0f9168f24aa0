"""Nested choice: the people that are scored have no part in what is chosen for them."""

from __future__ import annotations

from dataclasses import asdict, replace

import numpy as np
import pytest
from test_learners_study import SMALL, made_up

from holdfast.training.crossval import splits_of
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.recording import DataSet
from studies.real.nested_choice import (
    PREDICTION,
    SITUATIONS,
    Considered,
    FoldChoice,
    chosen_fold,
    figures_of,
)

GOOD, BLIND = "says it", "says nothing"


def considered(data: DataSet) -> dict[str, Considered]:
    """One set of features that says the situation, and one that is the same for all."""
    features = features_of(data, spec_for(data, SMALL.groups))
    nothing = {task: np.zeros_like(rows) for task, rows in features.items()}
    return {
        BLIND: Considered(data, nothing, SMALL),
        GOOD: Considered(data, features, SMALL),
    }


def choose(data: DataSet, of: dict[str, Considered]) -> list[FoldChoice]:
    splits = splits_of(data, SMALL, 0)
    return [chosen_fold(of, split, 0, lambda line: None) for split in splits]


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
    again = chosen_fold(considered(other), split, 0, lambda line: None)
    assert again == folds[0]
