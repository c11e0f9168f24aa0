"""Methods side by side on human_slip_uskin, people held out. A job is one fold of one method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import islice
from typing import TypeVar

import numpy as np

from holdfast.evaluation.jobs import Job, Workers
from holdfast.export.exporting import whole_graph
from holdfast.export.heads import Head
from holdfast.export.pooled import FAMILIES
from holdfast.export.verify import Verification, verify
from holdfast.training.crossval import (
    FoldAnswers,
    HeldOut,
    answer_fold,
    splits_of,
    uncalibrated,
)
from holdfast.training.datasets import find, human_slip_uskin
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.figures import HeadFigures
from holdfast.training.fitting import held_out_figures
from holdfast.training.plan import RAW_BASELINE, TASK_HEADS, ForestPlan, TrainingPlan
from holdfast.training.progress import Say
from holdfast.training.recording import DataSet
from studies.real.taxels import (
    SPREAD_TAXELS_CARD,
    clock_features,
    spread_taxels,
    with_taxels,
)
from studies.row_names import (
    CLOCK,
    COMMITTEE_18,
    OURS_18,
    POOLED_18,
    RAW_18,
    SPREAD_18,
    SPREAD_OWN_18,
)

HUMAN = "human_slip_uskin"
Result = TypeVar("Result")
Answered = tuple[FoldAnswers, Verification | None]
_SMOOTH = ForestPlan(kind="random", min_samples_leaf=20)
CLOCK_PLAN = TrainingPlan(groups=(), situation=_SMOOTH, prediction=_SMOOTH)
"""For the two numbers of the timing-only baseline: the best such forest found, to be fair."""


@dataclass(frozen=True)
class Method:
    """A row of a table: a plan on so many channels.

    verified: every fold's learners are exported and compared with the reference. spread: of 18
    channels, taxels spread over the pad instead of the most loaded.
    """

    plan: TrainingPlan
    channels: int = 18
    verified: bool = False
    spread: bool = False

    def data(self) -> DataSet:
        """The set with this method's channels and labels."""
        return _data(self.channels, self.spread)

    def features(self) -> dict[str, FloatRows]:
        """Task -> [M, F] for every window."""
        return _features(self.channels, self.spread, self.plan.groups)


OURS = Method(TrainingPlan(), verified=True)
BASELINES = {
    RAW_18: Method(RAW_BASELINE),
    CLOCK: Method(CLOCK_PLAN, channels=48),
}
"""The timing-only baseline sums all normals."""
COMMITTEE = TrainingPlan(learner="committee")
OWN_LEVEL = replace(
    COMMITTEE,
    groups=tuple(
        name.replace("scaled_differences", "own_scaled_differences")
        for name in COMMITTEE.groups
    ),
)
"""Changes at a sensor relative to its own load of the last 0.5 s, not to the grip force."""
PLACED = {
    COMMITTEE_18: Method(COMMITTEE),
    SPREAD_18: Method(COMMITTEE, spread=True),
    SPREAD_OWN_18: Method(OWN_LEVEL, spread=True),
}
"""What the places of six sensors are worth, then what own-level scaling adds."""
POOLED = Method(replace(COMMITTEE, groups=tuple(FAMILIES)), spread=True)
"""Pooled over sensors, all on one side: what it loses that no feature knows where a sensor lies."""
METHODS = {OURS_18: OURS, **PLACED, POOLED_18: POOLED, **BASELINES}
"""Rows of the table with people held out."""


@dataclass(frozen=True)
class Row:
    """What a method answered for all windows, and how well."""

    held_out: HeldOut
    figures: HeadFigures
    verifications: list[Verification]


def cross_validated(
    methods: dict[str, Method], seed: int, workers: Workers, say: Say
) -> dict[str, Row]:
    """Every method's row, by its name. say: receives every fold."""
    folds = {
        f"{name}, fold {fold + 1} of {method.plan.folds}": partial(
            _answer, method, fold, seed
        )
        for name, method in methods.items()
        for fold in range(method.plan.folds)
    }
    answers = done(folds, workers, say)
    return {name: _row(method, answers, seed) for name, method in methods.items()}


def done(
    parts: Mapping[str, Job[Result]], workers: Workers, say: Say
) -> Iterator[Result]:
    """The results in the order of the parts. say: what begins, or side by side what is done."""
    if workers.here:
        for name, part in parts.items():
            say(name)
            yield part()
        return
    say(f"{len(parts)} parts side by side")
    for name, result in zip(parts, workers.run(list(parts.values())), strict=True):
        say(f"{name}: done")
        yield result


def _row(method: Method, answers: Iterator[Answered], seed: int) -> Row:
    """Takes the next folds as its own."""
    folds = list(islice(answers, method.plan.folds))
    held_out = HeldOut.of(method.data(), [fold for fold, _ in folds])
    figures = held_out_figures(method.data(), held_out, seed)
    return Row(held_out, figures, [report for _, report in folds if report])


def _answer(method: Method, fold: int, seed: int) -> Answered:
    data = method.data()
    features = method.features()
    split = splits_of(data, method.plan, seed)[fold]
    answers = answer_fold(data, features, method.plan, split, seed)
    report = None
    if method.verified:
        report = verified(data, answers, features, method.plan, seed)
    # What answers is not sent back from another process.
    return replace(answers, learners={}), report


def verified(
    data: DataSet,
    answers: FoldAnswers,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    seed: int,
) -> Verification:
    """A fold's learners, exported and compared with the reference on all held-out rows."""
    spec = spec_for(data, plan.groups)
    heads = []
    for task, learner in answers.learners.items():
        classes = data.tasks[task].classes
        calibration = uncalibrated(len(classes))
        heads.append(Head(TASK_HEADS[task], classes, learner, calibration))
    # All heads read the same features, so rows of every task test each of them.
    seen = np.concatenate([features[task][rows] for task, rows in answers.rows.items()])
    return verify(whole_graph(spec, heads), spec, heads, seen, seed)


@lru_cache(maxsize=1)
def _data(channels: int, spread: bool) -> DataSet:
    if not spread:
        return human_slip_uskin.load(find(HUMAN), channels=channels)
    whole = human_slip_uskin.load(find(HUMAN), channels=48)
    return with_taxels(whole, spread_taxels(channels // 3), SPREAD_TAXELS_CARD)


@lru_cache(maxsize=1)
def _features(
    channels: int, spread: bool, groups: tuple[str, ...]
) -> dict[str, FloatRows]:
    """Features of the step, or those of the timing-only baseline."""
    data = _data(channels, spread)
    if groups != CLOCK_PLAN.groups:
        return features_of(data, spec_for(data, groups))
    clock = {task: clock_features(data, rows) for task, rows in data.tasks.items()}
    return {task: values.astype(np.float32) for task, values in clock.items()}
