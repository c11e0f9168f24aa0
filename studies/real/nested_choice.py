"""`python -m studies nested-choice`: taxels, features and learner chosen without the scored people.

Rows of `make real` compare sets of taxels and features on all people, so picking the best of them
would see the people that it is scored on. Here each fold's people are answered by the choice that
was best on the other people alone, their own people held out in turn. A choice is scored by the
sum of macro F1, AUC and average precision. One network stands for four while choosing.
"""

from __future__ import annotations

import argparse
import json
from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass, replace
from functools import cache, partial
from pathlib import Path

import numpy as np
from sklearn.metrics import average_precision_score, f1_score, roc_auc_score

from holdfast.cli.options import add_job_options, chosen_workers
from holdfast.core.contract import FloatArray, Json
from holdfast.core.progress import Stages
from holdfast.core.writing import require_writable, write_whole
from holdfast.data.datasets.human_slip_uskin import MOST_LOADED_TAXELS
from holdfast.data.metrics import report
from holdfast.data.recording import DataSet, assign_groups, folds_of
from holdfast.step.heads import riskier_argmax
from holdfast.step.learner import forest_votes, votes_of_trees
from holdfast.step.network import IntArray, network_votes
from holdfast.training.crossval import FloatRows, splits_of
from holdfast.training.network_fit import fit_network
from holdfast.training.plan import TrainingPlan
from studies.real.methods import COMMITTEE, POOLED, Method, done
from tools.harness import measured_now, write_figures

INNER_FOLDS = 2
METHODS = {
    "most loaded taxels": Method(COMMITTEE, six=MOST_LOADED_TAXELS),
    "spread taxels": Method(COMMITTEE),
    "spread taxels, pooled features": POOLED,
}
"""Taxels and features; each with every learner of LEARNERS is a choice."""
LEARNERS = ("forest", "network", "committee")
SITUATIONS, PREDICTION = "situations", "predict_250ms"
Split = Mapping[str, tuple[IntArray, IntArray]]
"""Task -> training and test rows; all tasks hold out the same people."""


@dataclass(frozen=True)
class Candidate:
    """A method's set, its features by task, and its plan."""

    data: DataSet
    features: Mapping[str, FloatRows]
    plan: TrainingPlan


@dataclass(frozen=True)
class FoldChoice:
    """What one fold chose, the inner score of every choice, and what the choice answered.

    situation: of the test windows of the situations. risky: share of votes at the test windows of
    the prediction.
    """

    method: str
    learner: str
    scores: dict[str, float]
    situation: list[int]
    risky: list[float]


def learner_votes(
    one: Candidate,
    plan: TrainingPlan,
    task: str,
    train: IntArray,
    test: IntArray,
    seed: int,
) -> dict[str, IntArray]:
    """Learner -> its votes [N, K] on the test rows of a task, fitted on the training rows."""
    features = one.features[task]
    rows = one.data.tasks[task]
    k = len(rows.classes)
    label = rows.label[train]
    forest = plan.forest_for(task).build(seed, n_jobs=1)
    forest.fit(np.asfortranarray(features[train]), label)
    in_all = votes_of_trees(len(forest.estimators_))
    how = plan.network_for(task)
    network = fit_network(how, features[train], label, k, seed, in_all)
    trees = forest_votes(forest, features[test], k)
    nets = network_votes(network, features[test])
    return {"forest": trees, "network": nets, "committee": trees + nets}


def chosen_fold(of: Mapping[str, Candidate], split: Split, seed: int) -> FoldChoice:
    """Choose on a fold's training people, then answer its test people."""
    scores: dict[tuple[str, str], float] = {}
    for name, one in of.items():
        for learner, score in _inner_scores(one, split, seed).items():
            scores[name, learner] = score
    method, learner = max(scores, key=lambda choice: scores[choice])
    one = of[method]
    votes = {}
    for task, (train, test) in split.items():
        votes[task] = learner_votes(one, one.plan, task, train, test, seed)[learner]
    return FoldChoice(
        method,
        learner,
        {", ".join(choice): score for choice, score in scores.items()},
        riskier_argmax(votes[SITUATIONS]).tolist(),
        _share(votes[PREDICTION]).tolist(),
    )


def _inner_scores(one: Candidate, split: Split, seed: int) -> dict[str, float]:
    """Learner -> its score on the training people, who are held out in turn."""
    plan = replace(
        one.plan,
        network=replace(one.plan.network, members=1),
        prediction_network=replace(one.plan.prediction_network, members=1),
    )
    people = one.data.group_of(SITUATIONS)[split[SITUATIONS][0]]
    inner = assign_groups(people, INNER_FOLDS, seed=seed)
    votes: dict[str, dict[str, IntArray]] = {name: {} for name in LEARNERS}
    truth = {}
    for task, (rows, _) in split.items():
        task_rows = one.data.tasks[task]
        truth[task] = task_rows.label[rows]
        for name in LEARNERS:
            votes[name][task] = np.zeros((len(rows), len(task_rows.classes)), np.int64)
        for train, test in folds_of(one.data.group_of(task)[rows], inner):
            found = learner_votes(one, plan, task, rows[train], rows[test], seed)
            for name, of_learner in found.items():
                votes[name][task][test] = of_learner
    return {name: _score(found, truth) for name, found in votes.items()}


def _score(votes: Mapping[str, IntArray], truth: Mapping[str, IntArray]) -> float:
    """Macro F1 of the situations, plus AUC and average precision of the prediction."""
    answered = riskier_argmax(votes[SITUATIONS])
    risky = _share(votes[PREDICTION])
    return float(
        f1_score(truth[SITUATIONS], answered, average="macro")
        + roc_auc_score(truth[PREDICTION], risky)
        + average_precision_score(truth[PREDICTION], risky)
    )


def _share(votes: IntArray) -> FloatArray:
    share: FloatArray = votes[:, 1] / votes.sum(axis=1)
    return share


def figures_of(
    data: DataSet, splits: list[dict[str, tuple[IntArray, IntArray]]], folds: list[Json]
) -> Json:
    """The figures of all folds together, what each chose, and how often."""
    situation = np.zeros(len(data.tasks[SITUATIONS]), np.int64)
    risky = np.zeros(len(data.tasks[PREDICTION]))
    for split, fold in zip(splits, folds, strict=True):
        situation[split[SITUATIONS][1]] = fold["situation"]
        risky[split[PREDICTION][1]] = fold["risky"]
    chosen = [f"{fold['method']}, {fold['learner']}" for fold in folds]
    return {
        "row": report(data, situation, risky).to_json(),
        "chosen": dict(Counter(chosen).most_common()),
        "inner_scores": [fold["scores"] for fold in folds],
    }


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_job_options(parser, 2)


def run(args: argparse.Namespace) -> int:
    """Choose fold by fold, side by side, each kept in a file; write nested-choice.json."""
    require_writable(args.out)
    first = next(iter(METHODS.values()))
    splits = splits_of(first.data(), first.plan, args.seed)
    jobs = {
        f"fold {number} of {len(splits)}": partial(
            _kept, args.out.absolute() / "nested", number, args.seed
        )
        for number in range(1, len(splits) + 1)
    }
    say = Stages()
    folds = list(done(jobs, chosen_workers(args), say))
    figures = {
        "kind": "public real data",
        **measured_now(),
        "seed": args.seed,
        "folds": len(splits),
        "inner_folds": INNER_FOLDS,
        **figures_of(first.data(), splits, folds),
    }
    print(write_figures(args.out / "nested-choice.json", figures))
    return 0


@cache
def _considered() -> dict[str, Candidate]:
    """All choices; read and computed once in each process."""
    return {
        name: Candidate(method.data(), method.features(), method.plan)
        for name, method in METHODS.items()
    }


def _kept(folder: Path, number: int, seed: int) -> Json:
    """A fold from its file, or chosen and written there."""
    path = folder / f"{seed}-{number}.json"
    if not path.is_file():
        of = _considered()
        first = next(iter(of.values()))
        split = splits_of(first.data, first.plan, seed)[number - 1]
        folder.mkdir(parents=True, exist_ok=True)
        write_whole(path, json.dumps(vars(chosen_fold(of, split, seed))) + "\n")
    fold: Json = json.loads(path.read_text("utf-8"))
    return fold
