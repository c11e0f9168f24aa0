"""How well a classifier tells simulated windows from real ones, by group of features.

0.5 means that it cannot. Both sides give as many windows of each situation that both have, so that
the mixture gives nothing away; folds keep a person, or a simulated trial, on one side.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace

import numpy as np

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, IntArray
from holdfast.core.reading import Json
from holdfast.export.features import GROUPS
from holdfast.export.spec import StepSpec
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.figures import PredictionFigures
from holdfast.training.metrics import prediction_scores
from holdfast.training.plan import CLOCK_FREE_GROUPS, ForestPlan
from holdfast.training.recording import DataSet, StringArray, grouped_folds

SITUATIONS = (NOTHING, GRASP, RISKY_SLIP)
"""Of these windows are taken; a safe slip means something else in either world."""
WINDOWS = 500
"""Of each situation from either side, at most."""
FOLDS = 4
FOREST = ForestPlan(n_estimators=60, min_samples_leaf=4)
SHIPPED_GROUPS = "all groups of fixed features"
HALVES = "people against other people"


def drawn(data: DataSet, counts: Mapping[int, int], seed: int) -> DataSet:
    """The set with so many windows of each situation, drawn at random."""
    rng = np.random.default_rng(seed)
    task = data.tasks["situations"]
    kept = [
        rng.choice(np.flatnonzero(task.label == label), count, replace=False)
        for label, count in counts.items()
    ]
    chosen = np.sort(np.concatenate(kept))
    return replace(data, tasks={"situations": task.take(chosen)})


def counts_of(sets: Sequence[DataSet]) -> dict[int, int]:
    """How many windows of each situation all of the sets can give."""
    counts = {}
    for label in SITUATIONS:
        have = [int(np.sum(one.tasks["situations"].label == label)) for one in sets]
        counts[label] = min(WINDOWS, *have)
    return counts


def by_group(data: DataSet, spec: StepSpec) -> dict[str, FloatRows]:
    """Group -> its features [M, ..] at the windows of a set."""
    rows = features_of(data, spec)["situations"]
    found = {}
    at = 0
    for name in spec.groups:
        width = GROUPS[name].count(spec)
        found[name] = rows[:, at : at + width]
        at += width
    used = [found[name] for name in CLOCK_FREE_GROUPS]
    return {**found, SHIPPED_GROUPS: np.hstack(used)}


def told_apart(
    first: FloatRows,
    second: FloatRows,
    groups: tuple[StringArray, StringArray],
    seed: int,
) -> PredictionFigures:
    """AUC of a forest for "of the second set", each window scored without its group.

    groups: of the windows of both; names may be the same in both sets.
    """
    rows = np.asfortranarray(np.vstack([first, second]))
    label: IntArray = np.repeat([0, 1], [len(first), len(second)]).astype(np.int64)
    names = np.concatenate([np.char.add("0/", groups[0]), np.char.add("1/", groups[1])])
    fold_of = np.zeros(len(rows), np.int64)
    for side in (0, 1):
        # each side is dealt by itself, so that every fold has both
        here = np.flatnonzero(label == side)
        dealt = grouped_folds(names[here], FOLDS, seed=seed)
        for fold, (_, test) in enumerate(dealt):
            fold_of[here[test]] = fold
    score = np.zeros(len(rows))
    for fold in range(FOLDS):
        test_rows = fold_of == fold
        forest = FOREST.build(seed).fit(rows[~test_rows], label[~test_rows])
        score[test_rows] = forest.predict_proba(rows[test_rows])[:, 1]
    return prediction_scores(label, score, names, seed=seed)


def domain_rows(name: str, scenes: DataSet, people: DataSet, seed: int) -> list[Json]:
    """A row for each group of features. Both sets have the task situations, and one level."""
    counts = counts_of([scenes, people])
    pair = [drawn(one, counts, seed) for one in (scenes, people)]
    spec = spec_for(people, tuple(GROUPS))
    features = [by_group(one, spec) for one in pair]
    groups = (pair[0].group_of("situations"), pair[1].group_of("situations"))
    rows = []
    for group in features[0]:
        found = told_apart(features[0][group], features[1][group], groups, seed)
        rows.append(
            {
                "scene": name,
                "group": group,
                "windows": 2 * sum(counts.values()),
                "auc": found.auc,
                "auc_ci": found.auc_ci,
            }
        )
    return rows


def halves(people: DataSet, seed: int) -> tuple[DataSet, DataSet]:
    """Two halves of the people, dealt at random."""
    names = np.random.default_rng(seed).permutation(people.groups())
    half = len(names) // 2
    return people.of_groups(names[:half]), people.of_groups(names[half:])
