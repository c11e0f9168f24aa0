"""The study: every learner on streams of trials, daily grasps, disturbed holds and unseen styles.

Two questions are asked of each. Trained on `thesis` and `broad`, as the shipped model is: what does
it call on other trials, on `daily`, on disturbed holds, and on two styles that were no part of it?
And trained on two styles alone, without `broad`: what does it call on the third? The threshold is
the lowest that leaves half a false alarm a minute on `daily`, other streams than those evaluated.
All simulated.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from benchmarks.timed_calls import learner_call, step_call
from holdfast.core.contract import CLASSES, RISKY_SLIP
from holdfast.evaluation.alarms import Answers, choose_confidence, event_scores
from holdfast.evaluation.latency.timing import time_in_turns
from holdfast.evaluation.methods import MethodResult, method_figures, together
from holdfast.export.exporting import whole_graph
from holdfast.export.heads import Head, riskier_argmax, situation_votes
from holdfast.export.learner import Learner, reference_votes
from holdfast.export.spec import StepSpec
from holdfast.export.verify import cut_learners
from holdfast.training.crossval import learner_of, uncalibrated
from holdfast.training.featurise import FloatRows
from holdfast.training.plan import CLOCK_FREE_GROUPS, SIZES, TrainingPlan
from holdfast.training.progress import Say, ignored
from studies.fast_handover.ideas import VARIED
from studies.fast_handover.learners import Answer
from studies.fast_handover.sets import (
    CHOOSE,
    Labelled,
    Streams,
    joined,
    labelled,
    streams,
)
from studies.fast_handover.stream_scores import (
    MOST_FALSE_PER_MIN,
    ONE_SAMPLE,
    answers_of,
    called,
)
from studies.learner_streams.figures import CurvePoint, LearnerRow, StreamFigures

EVALUATED = ("author", "asked-daily", "p1", "p2", "asked-holds")
UNSEEN = ("p1", "p2")
STYLES_KEPT = {"author": ("p1", "p2"), "p1": ("thesis", "p2"), "p2": ("thesis", "p1")}
"""A style left out -> the sets of the other two styles; `thesis` and `author` are one style."""
DEFAULT = SIZES["default"]
TWO_LAYERS = replace(DEFAULT.network, hidden=(64, 32))
PLANS: dict[str, TrainingPlan] = {
    "forest, 8 trees": replace(SIZES["tiny"], learner="forest"),
    "forest, 20 trees": replace(DEFAULT, learner="forest"),
    "network": replace(DEFAULT, learner="network"),
    "network, two hidden layers": replace(
        DEFAULT, learner="network", network=TWO_LAYERS
    ),
    "committee, 8 trees": replace(SIZES["tiny"], learner="committee"),
    "committee, 20 trees": replace(DEFAULT, learner="committee"),
    "committee, two hidden layers": replace(
        DEFAULT, learner="committee", network=TWO_LAYERS
    ),
    "forest, 100 trees": replace(SIZES["best"], learner="forest"),
}
SPEC = StepSpec(n_sensors=6, rate_hz=150.0, unit="N", groups=CLOCK_FREE_GROUPS)
TURNS, CALLS, TIMED_ROWS = 20, 50, 200
THRESHOLDS = tuple(range(400, 1000, 20))
"""Of the curves, thousandths."""


class Sets:
    """The sets of a folder; features at every sample stay on disk."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self._windows: dict[str, Labelled] = {}
        self._trials: dict[str, Streams] = {}

    def part(self, names: Sequence[str]) -> Labelled:
        """Dense windows of some sets, to train on."""
        for name in names:
            if name not in self._windows:
                self._windows[name] = labelled(
                    self.folder / name, "balanced", "default"
                )
        return joined([self._windows[name] for name in names])

    def streams(self, name: str) -> Streams:
        """A set to evaluate on."""
        if name not in self._trials:
            self._trials[name] = streams(self.folder / name, "natural", "default")
        return self._trials[name]


def study(
    folder: Path,
    seed: int,
    say: Say,
    plans: Mapping[str, TrainingPlan] = PLANS,
    keep: Callable[[list[LearnerRow]], object] = ignored,
) -> list[LearnerRow]:
    """A row a learner; keep is called with all rows so far, times come last.

    folder: holds the sets by their names. Raises what reading them raises.
    """
    sets, rows, learners = Sets(folder), [], {}
    for name, plan in plans.items():
        say(name)
        learners[name] = _fitted(plan, sets.part(VARIED), seed)
        rows.append(_row(name, plan, learners[name], sets, seed))
        keep(rows)
    us = _times_us(learners, sets.streams("author"))
    return [
        replace(row, learner_us=us[row.name][0], step_us=us[row.name][1])
        for row in rows
    ]


def _row(
    name: str, plan: TrainingPlan, learner: Learner, sets: Sets, seed: int
) -> LearnerRow:
    answers = _answers(learner, sets, (CHOOSE, *EVALUATED))
    permille = _threshold(answers)
    found = {
        one: called(sets.streams(one), answers[one], permille) for one in EVALUATED
    }
    here = {one: _figures(sets, [(one, result)], seed) for one, result in found.items()}
    return LearnerRow(
        name=name,
        learner=plan.learner,
        permille=permille,
        sets=here,
        unseen=_figures(sets, [(one, found[one]) for one in UNSEEN], seed),
        left_out=_figures(sets, _left_out(plan, sets, seed), seed),
        curve=_curve(answers, sets),
    )


def _left_out(
    plan: TrainingPlan, sets: Sets, seed: int
) -> list[tuple[str, MethodResult]]:
    """Each style, and what a learner that was trained on the others calls on it."""
    results = []
    for style, others in STYLES_KEPT.items():
        learner = _fitted(plan, sets.part(others), seed)
        answers = _answers(learner, sets, (CHOOSE, style))
        results.append(
            (style, called(sets.streams(style), answers[style], _threshold(answers)))
        )
    return results


def _fitted(plan: TrainingPlan, part: Labelled, seed: int) -> Learner:
    return learner_of(plan, "classes", part.features, part.label, len(CLASSES), seed)


def _threshold(answers: Mapping[str, Sequence[Answers]]) -> int:
    """In thousandths of the votes, from streams of `daily`."""
    return choose_confidence(answers[CHOOSE], ONE_SAMPLE, MOST_FALSE_PER_MIN)


def _curve(answers: Mapping[str, Sequence[Answers]], sets: Sets) -> list[CurvePoint]:
    """What each threshold would give on the unseen styles."""
    points = []
    for permille in THRESHOLDS:
        found = [called(sets.streams(name), answers[name], permille) for name in UNSEEN]
        result = together(found)
        scores = event_scores(result.matches, n_draws=0)
        share = float(np.mean([action.called for action in result.actions]))
        points.append(
            CurvePoint(
                permille, scores.recall, scores.in_time, scores.false_per_min, share
            )
        )
    return points


def _answers(
    learner: Learner, sets: Sets, names: Sequence[str]
) -> dict[str, list[Answers]]:
    """The answers to every sample of some sets."""
    found = {}
    for name in names:
        here = sets.streams(name)
        found[name] = answers_of(here, _answer(learner, here.features))
    return found


def _answer(learner: Learner, features: FloatRows) -> Answer:
    """Situation [T] and thousandths for a risky slip [T]."""
    votes = situation_votes(
        reference_votes(learner, np.asarray(features), len(CLASSES))
    )
    return riskier_argmax(votes), (1000 * votes[:, RISKY_SLIP]) // votes.sum(axis=1)


def _figures(
    sets: Sets, parts: Sequence[tuple[str, MethodResult]], seed: int
) -> StreamFigures:
    """Figures of one set, or of several together."""
    trials = [trial for name, _ in parts for trial in sets.streams(name).trials]
    results = [result for _, result in parts]
    result = results[0] if len(results) == 1 else together(results)
    return StreamFigures.of(method_figures(result, trials, None, seed))


def _times_us(
    learners: Mapping[str, Learner], timed: Streams
) -> dict[str, tuple[float, float]]:
    """Median of each learner and of its whole step, all interleaved; on rows of trials."""
    rows = np.array(
        timed.features[:: max(1, len(timed.features) // TIMED_ROWS)][:TIMED_ROWS]
    )
    samples = np.random.default_rng(0).uniform(0.0, 3.0, (TIMED_ROWS, SPEC.n_channels))
    calls: dict[str, Callable[[], object]] = {}
    for name, learner in learners.items():
        head = Head("situation", CLASSES, learner, uncalibrated(len(CLASSES)))
        model = whole_graph(SPEC, [head])
        calls[f"{name} learner"] = learner_call(cut_learners(model), rows)
        calls[f"{name} step"] = step_call(model.SerializeToString(), samples)
    us = {
        name: float(np.median(one))
        for name, one in time_in_turns(calls, TURNS, CALLS).items()
    }
    return {name: (us[f"{name} learner"], us[f"{name} step"]) for name in learners}
