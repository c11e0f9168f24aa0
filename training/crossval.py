"""Cross-validation by person, and calibration from its held-out votes.

Predictions are the reference's (quantised leaves, riskier class on ties), that is, the exported
file's: with `verify_spec` every fold's forest really is exported and compared on every held-out
row.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np
import numpy.typing as npt
from sklearn.linear_model import LogisticRegression

from edge_runtime.errors import ClassMissing
from export.exporting import whole_graph
from export.forest import Forest
from export.heads import Calibration, Head
from export.reference import IntArray, reference_votes, riskier_argmax, situation_votes
from export.spec import StepSpec
from export.verification import Verification
from export.verify import verify
from training.featurise import FloatRows
from training.plan import TASK_HEADS, TrainingPlan
from training.recording import DataSet
from training.say import Say
from training.splits import Fold, assign_groups, folds_of

CALIBRATION_C = 1.0
"""Inverse regularisation of the calibration (scikit-learn's C) on vote shares between 0 and 1."""


@dataclass(frozen=True)
class HeldOut:
    """Votes for every window, each from a forest that never saw its person.

    votes: task -> [M, K] exact integers. verification: one report a fold.
    """

    votes: dict[str, IntArray]
    verification: list[Verification] = field(default_factory=list)

    def shares(self, task: str) -> npt.NDArray[np.float64]:
        """[M, K] vote shares, rows summing to one."""
        votes = self.votes[task]
        return votes / votes.sum(axis=1, keepdims=True)

    def situations(self) -> IntArray:
        """[M] labels of the main task by the declared tie rule."""
        task = "classes" if "classes" in self.votes else "situations"
        return riskier_argmax(situation_votes(self.votes[task]))


def cross_validate(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    *,
    seed: int = 0,
    say: Say = lambda line: None,
    verify_spec: StepSpec | None = None,
) -> HeldOut:
    """Held-out votes for every window of every task; folds of people are shared by all tasks.

    features: task -> [M, F]. verify_spec: export every fold's forests and compare them on all
    held-out rows. A fold may hold out no window of a task; one that leaves none to train on is a
    ClassMissing. Raises TooFewGroups.
    """
    main = main_task(data)
    folds = assign_groups(_groups_of_all(data, main), plan.folds, seed=seed)
    splits = {task: folds_of(data.group_of(task), folds) for task in data.tasks}
    votes = {
        task: np.zeros((len(rows), len(rows.classes)), np.int64)
        for task, rows in data.tasks.items()
    }
    reports = []
    for fold in range(plan.folds):
        say(f"fold {fold + 1} of {plan.folds}")
        heads = [
            _fold_head(data, features, plan, task, splits[task][fold], seed) for task in data.tasks
        ]
        for task, head in zip(data.tasks, heads, strict=True):
            held = splits[task][fold][1]
            votes[task][held] = reference_votes(
                head.forest, features[task][held], len(head.classes)
            )
        if verify_spec is not None:
            rows = np.concatenate([features[task][splits[task][fold][1]] for task in data.tasks])
            reports.append(verify(whole_graph(verify_spec, heads), verify_spec, heads, rows, seed))
    return HeldOut(votes, reports)


def _groups_of_all(data: DataSet, main: str) -> npt.NDArray[np.str_]:
    """Groups of the main task's windows, then of those windows of other tasks with other people."""
    known = data.group_of(main)
    others = [data.group_of(task) for task in data.tasks if task != main]
    return np.concatenate([known, *(groups[~np.isin(groups, known)] for groups in others)])


def main_task(data: DataSet) -> str:
    """The main head's task: eight classes where the set has them, else four situations."""
    return "classes" if "classes" in data.tasks else "situations"


def fit_forest(
    data: DataSet,
    features: FloatRows,
    plan: TrainingPlan,
    task: str,
    rows: npt.NDArray[np.int64],
    seed: int,
) -> Forest:
    """The plan's forest for a task, fitted on some windows. Raises ClassMissing without any."""
    if not len(rows):
        raise ClassMissing(
            f"task {task}: no window to train on",
            where=data.name,
            cause="all of its windows are in recordings that are held out",
            next_step="add recordings of other people, or leave the task out",
        )
    by_column = np.asfortranarray(features[rows])  # as a tree reads them: the same forest, sooner
    return plan.forest_for(task).build(seed).fit(by_column, data.tasks[task].label[rows])


def fit_calibration(shares: npt.NDArray[np.float64], label: npt.NDArray[np.int64]) -> Calibration:
    """Multinomial logistic map from held-out vote shares [M, K] to probabilities.

    A class without a single window keeps a probability of (all but) zero.
    """
    k = shares.shape[1]
    present = np.unique(label)
    weights, bias = np.zeros((k, k)), np.full(k, -30.0)
    if len(present) == 1:
        bias[present] = 0.0
        return Calibration(weights, bias)
    model = LogisticRegression(C=CALIBRATION_C, max_iter=1000).fit(shares, label)
    if len(present) == 2:
        weights[:, present[1]], bias[present] = model.coef_[0], [0.0, model.intercept_[0]]
    else:
        weights[:, present], bias[present] = model.coef_.T, model.intercept_
    return Calibration(weights, bias)


def uncalibrated(n_classes: int) -> Calibration:
    """A placeholder for forests of single folds, whose probabilities are not used."""
    return Calibration(np.eye(n_classes), np.zeros(n_classes))


def _fold_head(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    task: str,
    split: Fold,
    seed: int,
) -> Head:
    forest = fit_forest(data, features[task], plan, task, split[0], seed)
    classes = data.tasks[task].classes
    return Head(TASK_HEADS[task], classes, forest, uncalibrated(len(classes)))
