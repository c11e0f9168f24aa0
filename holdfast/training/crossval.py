"""Windows -> features -> forest (or network, or both), the last of four steps, figures held out.

Features come from the step graph that runs on the hand. Recordings are stepped in batches on two
threads; which of them run together changes no bit of the outputs. Then cross-validation by person,
learners, and calibration from the held-out votes. Predictions are the reference's (quantised
leaves, riskier class on ties), that is, the exported file's.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, replace

import numpy as np
from sklearn.linear_model import LogisticRegression

from holdfast.core.contract import FloatArray, IntArray
from holdfast.core.errors import ClassMissing
from holdfast.core.progress import Part, Say, ignored
from holdfast.data.recording import (
    DataSet,
    Fold,
    Recording,
    StringArray,
    assign_groups,
    folds_of,
)
from holdfast.edge_runtime.graph import (
    Outputs,
    Steps,
    open_session,
    step_recordings,
    steps_of,
)
from holdfast.step.features import features_alone
from holdfast.step.heads import (
    FloatRows,
    VoteCalibration,
    riskier_argmax,
    situation_votes,
)
from holdfast.step.learner import Forest, Learner, reference_votes, votes_of_trees
from holdfast.step.network import VOTES
from holdfast.step.spec import StepSpec
from holdfast.training.plan import TASK_HEADS, ForestPlan, TrainingPlan, class_weights

THREADS = 2
FEWEST, MOST = 16, 32
"""Recordings a batch: a step of 5 costs little more than one of 2, and 32 states fit the cache."""
CALIBRATION_C = 1.0
"""Inverse regularisation of the calibration (scikit-learn's C) on vote shares between 0 and 1."""
ABSENT_NATS = -30.0
"""Logit of a class without a window: a probability of about 1e-13."""


# -- features by the graph that runs on the hand


def stepped(
    steps: Steps,
    recordings: Sequence[Recording],
    rows: Sequence[IntArray],
    part: Part = ignored,
) -> list[Outputs]:
    """Outputs [M, ..] of a step at the wanted rows [M] of every recording.

    part: called after every batch with the share of all samples that is done.
    """
    lengths = np.array([len(recording.samples) for recording in recordings])
    # Recordings of like length together: a batch is padded to its longest.
    order = np.argsort(lengths, kind="stable").tolist()
    # Half of them for each thread, as far as the limits of a batch allow.
    share = -(-len(order) // THREADS)
    size = min(MOST, max(FEWEST, share))
    batches = [order[start : start + size] for start in range(0, len(order), size)]

    def run(batch: list[int]) -> list[Outputs]:
        values = [recordings[k].samples for k in batch]
        valid = [recordings[k].valid for k in batch]
        wanted = [rows[k] for k in batch]
        return step_recordings(steps, values, valid, wanted)

    outputs: list[Outputs] = [{} for _ in recordings]
    all_samples = int(lengths.sum())
    done = 0
    # Threads and no processes: the step leaves the interpreter alone while it runs.
    with ThreadPoolExecutor(THREADS) as pool:
        for batch, of_batch in zip(batches, pool.map(run, batches), strict=True):
            for k, output in zip(batch, of_batch, strict=True):
                outputs[k] = output
            done += int(lengths[batch].sum())
            part(done / all_samples)
    return outputs


def spec_for(data: DataSet, groups: tuple[str, ...]) -> StepSpec:
    """The step a set is trained and served with: its sensors, its median rate, its unit."""
    # Where the newtons are not verified, a threshold in N may lie inside a firm grip.
    force_decides = None if data.forces_verified else False
    return StepSpec(
        n_sensors=data.n_sensors,
        rate_hz=data.rate_hz,
        unit=data.unit,
        groups=groups,
        hand=data.hand,
        force_decides=force_decides,
    )


def features_of_each_hand(
    data: DataSet, groups: tuple[str, ...], part: Part = ignored
) -> dict[str, FloatRows]:
    """As `features_of`, of a set that may join several hands, each by its own step."""
    if not data.parts:
        return features_of(data, spec_for(data, groups), part)
    # One row of features is of one window, whatever the task calls its labels.
    found = []
    for of_hand in data.parts:
        features = features_of(of_hand, spec_for(of_hand, groups), part)
        found.append({TASK_HEADS[task]: rows for task, rows in features.items()})
    return {
        task: np.concatenate(
            [rows[TASK_HEADS[task]] for rows in found if TASK_HEADS[task] in rows]
        )
        for task in data.tasks
    }


def features_of(
    data: DataSet, spec: StepSpec, part: Part = ignored
) -> dict[str, FloatRows]:
    """Task -> features [M, F] float32 at the last row of every window; one pass for all tasks."""
    # Per recording, the ascending rows at which any task has a window.
    wanted = [np.empty(0, np.int64) for _ in data.recordings]
    for windows in data.tasks.values():
        for trial in np.unique(windows.trial).tolist():
            # Windows of several tasks often end at the same row, which is computed once for all.
            rows = windows.row[windows.trial == trial]
            wanted[trial] = np.union1d(wanted[trial], rows)
    computed = features_at(data, spec, wanted, part)
    return {task: pick_rows(data, task, wanted, computed) for task in data.tasks}


def features_at(
    data: DataSet, spec: StepSpec, rows: list[IntArray], part: Part = ignored
) -> list[FloatRows]:
    """Features at these rows of each recording, by the graph without its learners."""
    # The graph that runs on the hand, so that a model is trained on what it will be given there.
    session = open_session(features_alone(spec).SerializeToString())
    # The other outputs of a step are its state, which training does not need.
    outputs = stepped(steps_of(session, ["features"]), data.recordings, rows, part)
    return [output["features"] for output in outputs]


def pick_rows(
    data: DataSet, task: str, wanted: list[IntArray], computed: list[FloatRows]
) -> FloatRows:
    """The task's windows in their order, out of what was computed per recording."""
    windows = data.tasks[task]
    first = computed[0]

    picked = np.empty((len(windows), *first.shape[1:]), dtype=first.dtype)
    for trial in np.unique(windows.trial).tolist():
        here = windows.trial == trial
        # The wanted rows ascend and hold every row of a window, so the search is exact.
        places = np.searchsorted(wanted[trial], windows.row[here])
        picked[here] = computed[trial][places]
    return picked


# -- learners and what they answer for people they never saw


@dataclass(frozen=True)
class FoldAnswers:
    """What the learners of one fold answer for the windows of its held-out people.

    rows: task -> [N] which windows of the task. votes: task -> [N, K] exact integers.
    """

    rows: dict[str, IntArray]
    votes: dict[str, IntArray]
    learners: dict[str, Learner]


@dataclass(frozen=True)
class HeldOut:
    """Votes for every window, each from a learner that never saw its person.

    votes: task -> [M, K] exact integers.
    """

    votes: dict[str, IntArray]

    @classmethod
    def of(cls, data: DataSet, folds: Sequence[FoldAnswers]) -> HeldOut:
        """The answers of all folds, window by window."""
        votes = {}
        for task, windows in data.tasks.items():
            votes[task] = np.zeros((len(windows), len(windows.classes)), np.int64)

        # Every window is held out by exactly one fold, so each row is written once.
        for fold in folds:
            for task, rows in fold.rows.items():
                votes[task][rows] = fold.votes[task]
        return cls(votes)

    def shares(self, task: str) -> FloatArray:
        """[M, K] vote shares, rows summing to one."""
        votes = self.votes[task]
        return votes / votes.sum(axis=1, keepdims=True)

    def situations(self) -> IntArray:
        """[M] labels of the main task by the declared tie rule."""
        return riskier_argmax(self.situation_votes())

    def situation_votes(self) -> IntArray:
        """[M, 4] votes of the main task."""
        main = "classes" if "classes" in self.votes else "situations"
        return situation_votes(self.votes[main])


def cross_validate(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    *,
    seed: int = 0,
    say: Say = ignored,
) -> HeldOut:
    """Held-out votes for every window of every task; folds of people are shared by all tasks.

    features: task -> [M, F]. A fold may hold out no window of a task; one that leaves none to train
    on is a ClassMissing. Raises TooFewGroups.
    """
    folds = []
    for number, split in enumerate(splits_of(data, plan, seed), 1):
        say(f"fold {number} of {plan.folds}")
        folds.append(answer_fold(data, features, plan, split, seed))
    return HeldOut.of(data, folds)


def splits_of(data: DataSet, plan: TrainingPlan, seed: int) -> list[dict[str, Fold]]:
    """Task -> training and test rows, of every fold; all tasks hold out the same people."""
    # Groups are dealt once for all tasks: a person held out of one is held out of every other.
    folds = assign_groups(_groups_of_all(data), plan.folds, seed=seed)

    splits: list[dict[str, Fold]] = [{} for _ in range(plan.folds)]
    for task in data.tasks:
        of_task = folds_of(data.group_of(task), folds)
        for split, fold in zip(splits, of_task, strict=True):
            split[task] = fold
    return splits


def _groups_of_all(data: DataSet) -> StringArray:
    """Groups of the main task's windows, then of those windows of other tasks with other people."""
    main = main_task(data)
    known = data.group_of(main)

    # Folds are balanced by the windows of the main task; groups that it lacks must be dealt too.
    groups = [known]
    for task in data.tasks:
        if task != main:
            others = data.group_of(task)
            groups.append(others[~np.isin(others, known)])
    return np.concatenate(groups)


def answer_fold(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    split: dict[str, Fold],
    seed: int,
) -> FoldAnswers:
    """Train on one fold's people and answer the windows of those it holds out.

    The arguments are those of `cross_validate`; split: one of `splits_of`.
    """
    answers = FoldAnswers({}, {}, {})
    for task, (train, test) in split.items():
        learner = fit_learner(data, features[task], plan, task, train, seed)
        n_classes = len(data.tasks[task].classes)
        answers.votes[task] = reference_votes(learner, features[task][test], n_classes)
        answers.rows[task], answers.learners[task] = test, learner
    return answers


def main_task(data: DataSet) -> str:
    """The main head's task: eight classes where the set has them, else four situations."""
    return "classes" if "classes" in data.tasks else "situations"


def fit_learner(
    data: DataSet,
    features: FloatRows,
    plan: TrainingPlan,
    task: str,
    rows: IntArray,
    seed: int,
) -> Learner:
    """The plan's learner for a task, fitted on some windows. Raises ClassMissing without any."""
    if not len(rows):
        raise ClassMissing(
            f"task {task}: no window to train on",
            where=data.name,
            cause="all of its windows are in recordings that are held out",
            next_step="add recordings of other people, or leave the task out",
        )

    given = data.tasks[task]
    chosen, label = features[rows], given.label[rows]
    counts_as = window_counts(plan, label, data.set_of(task)[rows])

    forest, votes = None, VOTES
    if plan.learner != "network":
        # a tree reads by column: the same forest, sooner
        by_column = np.asfortranarray(chosen)
        forest = fit_forest(plan.forest_for(task), by_column, label, counts_as, seed)
        # a network gets as many votes as the trees have in all, so that both count the same
        votes = votes_of_trees(len(forest.estimators_))
    if plan.learner == "forest":
        return Learner(forest)

    # a forest alone needs no network
    from holdfast.training.network_fit import fit_network

    how, n_classes = plan.network_for(task), len(given.classes)
    network = fit_network(how, chosen, label, n_classes, seed, votes, counts_as)
    return Learner(forest, network)


def window_counts(
    plan: TrainingPlan, label: IntArray, set_names: StringArray
) -> FloatArray | None:
    """[N] how many windows each window counts as; None where every window counts as one.

    All windows of a set that the plan gives a share count as much as this share of the windows that
    the other sets have of their class.
    """
    shared = np.isin(set_names, list(plan.set_shares))
    if not shared.any():
        return None
    counts_as = np.ones(len(label))
    others = np.bincount(label[~shared], minlength=label.max() + 1)
    for name, share in plan.set_shares.items():
        ours = set_names == name
        counts = np.maximum(np.bincount(label[ours], minlength=len(others)), 1)
        # A class that only this set has counts by its windows.
        by_class = np.where(others > 0, share * others / counts, 1.0)
        counts_as[ours] = by_class[label[ours]]
    return counts_as


def fit_forest(
    plan: ForestPlan,
    by_column: FloatRows,
    label: IntArray,
    counts_as: FloatArray | None,
    seed: int,
) -> Forest:
    """The forest of a plan on windows [N, F]. counts_as: of `window_counts`."""
    if counts_as is None:
        return plan.build(seed).fit(by_column, label)
    weight = counts_as
    if plan.class_weight == "balanced":
        # scikit-learn's own balance counts windows, not what they count as
        weight = counts_as * class_weights(label, counts_as)[label]
    unweighted = replace(plan, class_weight=None)
    return unweighted.build(seed).fit(by_column, label, sample_weight=weight)


def fit_calibration(
    shares: FloatArray, label: IntArray, counts_as: FloatArray | None = None
) -> VoteCalibration:
    """Multinomial logistic map from held-out vote shares [M, K] to probabilities.

    counts_as: of `window_counts`. A class without a single window keeps a probability of (all but)
    zero.
    """
    k = shares.shape[1]

    # A class without a window has nothing to fit: its weights stay 0, and its bias makes its
    # probability tiny.
    present = np.unique(label)
    weights = np.zeros((k, k))
    bias = np.full(k, ABSENT_NATS)
    if len(present) == 1:
        # Nothing to fit: scikit-learn refuses a single class.
        bias[present] = 0.0
        return VoteCalibration(weights, bias)

    # One map for all classes together, so that the probabilities of a window add up to 1.
    model = LogisticRegression(C=CALIBRATION_C, max_iter=1000)
    model.fit(shares, label, sample_weight=counts_as)
    if len(present) == 2:
        # Of two classes scikit-learn fits the second's logit alone.
        weights[:, present[1]] = model.coef_[0]
        bias[present] = [0.0, model.intercept_[0]]
    else:
        weights[:, present] = model.coef_.T
        bias[present] = model.intercept_
    return VoteCalibration(weights, bias)


def with_even_classes(
    calibration: VoteCalibration, label: IntArray, counts_as: FloatArray | None = None
) -> VoteCalibration:
    """The same map where every class that occurs is as likely as the others.

    How many windows a class has is a choice of the set's makers: by Bayes' rule, dividing all odds
    by those of the counts takes that choice out again.
    """
    counts = np.bincount(label, counts_as, minlength=len(calibration.bias))
    even = counts.sum() / np.maximum(counts, 1) / np.count_nonzero(counts)
    shift = np.where(counts > 0, np.log(even), 0.0)
    return VoteCalibration(calibration.weights, calibration.bias + shift)


def uncalibrated(n_classes: int) -> VoteCalibration:
    """A placeholder for learners of single folds, whose probabilities are not used."""
    return VoteCalibration(np.eye(n_classes), np.zeros(n_classes))
