"""Methods side by side on human_slip_uskin, people held out. A job is one fold of one method."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace
from functools import lru_cache, partial
from itertools import islice
from typing import TypeVar

import numpy as np

from holdfast.core.progress import Say
from holdfast.data.datasets import find, human_slip_uskin
from holdfast.data.datasets.human_slip_uskin import MOST_LOADED_TAXELS, SPREAD_TAXELS
from holdfast.data.metrics import HeadFigures
from holdfast.data.recording import DataSet
from holdfast.evaluation.jobs import Job, Workers
from holdfast.training.crossval import (
    FloatRows,
    FoldAnswers,
    HeldOut,
    answer_fold,
    features_of,
    spec_for,
    splits_of,
)
from holdfast.training.judging import held_out_figures
from holdfast.training.plan import POOLED_GROUPS, ForestPlan, TrainingPlan
from studies.real.clock import clock_features
from studies.row_names import CLOCK, OURS_18, SPREAD_18

HUMAN = "human_slip_uskin"
Result = TypeVar("Result")
_SMOOTH = ForestPlan(kind="random", min_samples_leaf=20, n_estimators=50)
CLOCK_PLAN = TrainingPlan(groups=(), situation=_SMOOTH, prediction=_SMOOTH)
"""For the two numbers of the timing-only baseline: the best such forest found, to be fair."""
COMMITTEE = TrainingPlan(learner="committee")


@dataclass(frozen=True)
class Method:
    """A row of a table: a plan on so many channels; six: the taxels of 18."""

    plan: TrainingPlan
    channels: int = 18
    six: tuple[int, ...] = SPREAD_TAXELS

    def data(self) -> DataSet:
        """The set with this method's channels."""
        return _data(self.channels, self.six)

    def features(self) -> dict[str, FloatRows]:
        """Task -> [M, F] for every window."""
        return _features(self.channels, self.six, self.plan.groups)


OURS = Method(TrainingPlan(), six=MOST_LOADED_TAXELS)
METHODS = {
    OURS_18: OURS,
    SPREAD_18: Method(COMMITTEE),
    # The timing-only baseline sums all normals.
    CLOCK: Method(CLOCK_PLAN, channels=48),
}
"""Rows of the table with people held out."""
POOLED = Method(replace(COMMITTEE, groups=POOLED_GROUPS))
"""Pooled over sensors, all on one side: no feature knows where a sensor lies."""


@dataclass(frozen=True)
class Row:
    """What a method answered for all windows, and how well."""

    held_out: HeldOut
    figures: HeadFigures


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


def _row(method: Method, answers: Iterator[FoldAnswers], seed: int) -> Row:
    """Takes the next folds as its own."""
    folds = list(islice(answers, method.plan.folds))
    held_out = HeldOut.of(method.data(), folds)
    return Row(held_out, held_out_figures(method.data(), held_out, seed))


def _answer(method: Method, fold: int, seed: int) -> FoldAnswers:
    data = method.data()
    split = splits_of(data, method.plan, seed)[fold]
    answers = answer_fold(data, method.features(), method.plan, split, seed)
    # What answers is not sent back from another process.
    return replace(answers, learners={})


@lru_cache(maxsize=1)
def _data(channels: int, six: tuple[int, ...]) -> DataSet:
    return human_slip_uskin.load(find(HUMAN), channels=channels, six=six)


@lru_cache(maxsize=1)
def _features(
    channels: int, six: tuple[int, ...], groups: tuple[str, ...]
) -> dict[str, FloatRows]:
    """Features of the step, or those of the timing-only baseline."""
    data = _data(channels, six)
    if groups != CLOCK_PLAN.groups:
        return features_of(data, spec_for(data, groups))
    clock = {task: clock_features(data, rows) for task, rows in data.tasks.items()}
    return {task: values.astype(np.float32) for task, values in clock.items()}
