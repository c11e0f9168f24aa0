"""Forest, network and committee with people held out: `make study NAME=learners`, learners.json.

Nested: a person's windows are answered by learners that never saw that person, with a network and
label weights chosen on the other people alone (their own people held out in turn).
"""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path

import numpy as np

from holdfast.core.contract import FloatArray
from holdfast.core.reading import Json
from holdfast.evaluation.jobs import Workers
from holdfast.export.heads import riskier_argmax
from holdfast.export.learner import LEARNERS, forest_votes, votes_of_trees
from holdfast.export.network import IntArray, network_votes
from holdfast.training.crossval import plan_for, splits_of
from holdfast.training.datasets import find
from holdfast.training.datasets.human_slip_uskin import load
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.figures import HeadFigures
from holdfast.training.metrics import report, situation_scores
from holdfast.training.network_fit import fit_members, in_whole_numbers
from holdfast.training.plan import NetworkPlan, TrainingPlan
from holdfast.training.recording import DataSet, grouped_folds
from holdfast.training.tuning import fit_label_weights, situation_labels
from tools.harness import write_figures

UNQUANTISED = "network before it is made of whole numbers"
WEIGHTED = "label weights"
INNER_FOLDS = 2
CASES = ((18, False), (18, True), (48, False))
"""Channels, and whether the label is the truer one; the file is written after each."""
PLAN = TrainingPlan(learner="committee", inner_folds=INNER_FOLDS)
Votes = dict[str, IntArray]
"""Learner -> votes [N, K]."""


@dataclass(frozen=True)
class Answers:
    """Of one fold: votes by task and learner, labels by learner, shares before quantising.

    networks: as chosen for each task.
    """

    votes: dict[str, Votes]
    labels: dict[str, IntArray]
    real_labels: IntArray
    networks: dict[str, NetworkPlan]


@dataclass(frozen=True)
class LearnerFigures:
    """Figures by row (learner, or learner with label weights) and by person (macro F1).

    networks: chosen for each task, of every fold.
    """

    channels: int
    in_hand: bool
    rows: dict[str, HeadFigures]
    people: dict[str, dict[str, float | None]]
    networks: list[dict[str, NetworkPlan]]

    def to_json(self) -> Json:
        """As it stands in learners.json."""
        rows = {name: row.to_json() for name, row in self.rows.items()}
        return asdict(self) | {"rows": rows}


def study_learners(
    data: DataSet, channels: int, in_hand: bool, seed: int, plan: TrainingPlan = PLAN
) -> LearnerFigures:
    """All learners on one set, people held out, two folds at a time."""
    features = features_of(data, spec_for(data, plan.groups))
    splits = splits_of(data, plan, seed)
    answers = Workers(2).run(
        [partial(_fold, data, features, plan, one, seed) for one in splits]
    )
    held = [{task: rows[1] for task, rows in one.items()} for one in splits]
    return _figures(
        data, channels, in_hand, list(zip(held, answers, strict=True)), seed
    )


def _fold(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    split: Mapping[str, tuple[IntArray, IntArray]],
    seed: int,
) -> Answers:
    """Train on the people of one fold, answer the windows of the others."""
    votes = {}
    real = np.zeros(0, np.int64)
    for task, (train, test) in split.items():
        plan = plan_for(data, features, plan, task, train, seed)
        votes[task], shares = learner_votes(
            data, features[task], plan, task, train, test, seed
        )
        if task == "situations":
            real = np.argmax(shares, axis=1)
    train = split["situations"][0]
    inner = _inner_votes(data, features["situations"], plan, train, seed)
    truth = data.tasks["situations"].label[train]
    labels = {
        name: situation_labels(
            votes["situations"][name], fit_label_weights(inner[name], truth)
        )
        for name in LEARNERS
    }
    return Answers(
        votes, labels, real, {task: plan.network_for(task) for task in split}
    )


def _inner_votes(
    data: DataSet, features: FloatRows, plan: TrainingPlan, rows: IntArray, seed: int
) -> Votes:
    """Votes for the training windows, their own people held out in turn."""
    inner = {name: np.zeros((len(rows), 4), np.int64) for name in LEARNERS}
    for train, test in grouped_folds(
        data.group_of("situations")[rows], INNER_FOLDS, seed=seed
    ):
        seen = rows[train]
        asked = rows[test]
        found, _ = learner_votes(data, features, plan, "situations", seen, asked, seed)
        for name, votes in found.items():
            inner[name][test] = votes
    return inner


def learner_votes(
    data: DataSet,
    features: FloatRows,
    plan: TrainingPlan,
    task: str,
    train: IntArray,
    test: IntArray,
    seed: int,
) -> tuple[Votes, FloatArray]:
    """Votes of every learner on test windows, and the network's shares before quantising."""
    rows = data.tasks[task]
    k = len(rows.classes)
    label = rows.label[train]
    forest = plan.forest_for(task).build(seed, n_jobs=1)
    forest.fit(np.asfortranarray(features[train]), label)
    members = fit_members(plan.network_for(task), features[train], label, seed)
    in_all = votes_of_trees(len(forest.estimators_))
    network = in_whole_numbers(members, features[train], k, in_all)
    trees = forest_votes(forest, features[test], k)
    nets = network_votes(network, features[test])
    shares = members.shares(features[test], k)
    return {"forest": trees, "network": nets, "committee": trees + nets}, shares


def _figures(
    data: DataSet,
    channels: int,
    in_hand: bool,
    folds: list[tuple[dict[str, IntArray], Answers]],
    seed: int,
) -> LearnerFigures:
    n = len(data.tasks["situations"])
    plain = {}
    weighted = {}
    for name in LEARNERS:
        plain[name] = np.zeros(n, np.int64)
        weighted[name] = np.zeros(n, np.int64)
        for held, found in folds:
            rows = held["situations"]
            plain[name][rows] = riskier_argmax(found.votes["situations"][name])
            weighted[name][rows] = found.labels[name]
    real = np.zeros(n, np.int64)
    for held, found in folds:
        real[held["situations"]] = found.real_labels
    scores = {name: _scores(data, folds, name) for name in LEARNERS}
    figures = {
        name: report(data, plain[name], scores[name], seed=seed) for name in LEARNERS
    }
    figures |= {
        f"{name}, {WEIGHTED}": report(data, weighted[name], scores[name], seed=seed)
        for name in LEARNERS
    }
    figures[UNQUANTISED] = report(data, real, None, seed=seed)
    networks = [found.networks for _, found in folds]
    return LearnerFigures(
        channels, in_hand, figures, _by_person(data, weighted), networks
    )


def _scores(
    data: DataSet, folds: list[tuple[dict[str, IntArray], Answers]], name: str
) -> FloatArray:
    """[M] share of votes for yes, risky within 0.25 s."""
    score = np.zeros(len(data.tasks["predict_250ms"]))
    for held, found in folds:
        votes = found.votes["predict_250ms"][name]
        score[held["predict_250ms"]] = votes[:, 1] / votes.sum(axis=1)
    return score


def _by_person(
    data: DataSet, labels: dict[str, IntArray]
) -> dict[str, dict[str, float | None]]:
    """Macro F1 with label weights, by person and learner."""
    truth = data.tasks["situations"].label
    people = data.group_of("situations")
    return {
        str(person): {
            name: _macro_f1(truth[people == person], found[people == person])
            for name, found in labels.items()
        }
        for person in np.unique(people)
    }


def _macro_f1(truth: IntArray, found: IntArray) -> float | None:
    return situation_scores(
        truth, found, np.zeros(len(truth), np.int64), n_draws=1
    ).macro_f1


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """This study has no options of its own."""


def run(args: argparse.Namespace) -> int:
    """Study all cases; write learners.json after each. A run goes on where an equal one stopped."""
    out: Path = args.out / "learners.json"
    root = find("human_slip_uskin")
    plan: Json = json.loads(json.dumps(PLAN.to_json()))
    kept = kept_cases(out, plan, args.seed)
    for channels, in_hand in CASES:
        if (channels, in_hand) in kept:
            continue
        sys.stderr.write(f"{channels} channels{', in the hand' if in_hand else ''}\n")
        data = load(root, channels=channels, in_hand=in_hand)
        studied = study_learners(data, channels, in_hand, args.seed)
        kept[channels, in_hand] = studied.to_json()
        figures = {
            "kind": "public real data",
            "seed": args.seed,
            "plan": plan,
            "studied": [kept[case] for case in CASES if case in kept],
        }
        write_figures(out, figures)
    return 0


def kept_cases(out: Path, plan: Json, seed: int) -> dict[tuple[int, bool], Json]:
    """What a run of the same plan and seed has written: (channels, in_hand) -> figures."""
    if not out.is_file():
        return {}
    written = json.loads(out.read_text("utf-8"))
    if (written["plan"], written["seed"]) != (plan, seed):
        return {}
    return {(one["channels"], one["in_hand"]): one for one in written["studied"]}
