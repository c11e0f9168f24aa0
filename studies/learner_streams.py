"""`python -m studies learner-streams`: learners on whole streams, also of styles left out.

Two questions are asked of each. Trained on `thesis` and `broad`, as the shipped model is: what does
it call on other trials, on `daily`, on disturbed holds, and on two styles that were no part of it?
And trained on two styles alone, without `broad`: what does it call on the third? The threshold is
the lowest that leaves half a false alarm a minute on `daily`, other streams than those evaluated.
All simulated.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

import numpy as np

from benchmarks.timed_calls import learner_call, step_call
from holdfast.core.contract import CLASSES
from holdfast.core.reading import Json
from holdfast.core.writing import require_writable
from holdfast.evaluation.alarms import Answers, choose_confidence, event_scores
from holdfast.evaluation.latency.timing import time_in_turns
from holdfast.evaluation.methods import MethodResult, method_figures, together
from holdfast.export.exporting import whole_graph
from holdfast.export.heads import Head
from holdfast.export.learner import Learner, reference_votes
from holdfast.export.spec import StepSpec
from holdfast.export.verify import cut_learners
from holdfast.training.crossval import learner_of, uncalibrated
from holdfast.training.plan import CLOCK_FREE_GROUPS, SIZES, TrainingPlan
from holdfast.training.progress import Say, ignored, stages
from studies.fast_handover.ideas import VARIED
from studies.fast_handover.learners import answer_of
from studies.fast_handover.sets import (
    CHOOSE,
    Labelled,
    Streams,
    streams,
    training_part,
)
from studies.fast_handover.stream_scores import (
    KEPT,
    MOST_FALSE_PER_MIN,
    ONE_SAMPLE,
    answers_of,
    called,
    picked,
)
from studies.stream_sets import STREAMS, add_sets_option, sets_folder
from tools.harness import SimulatedSet, write_figures

SETS = [*STREAMS, SimulatedSet("asked-daily", "daily", 370, 1006)]
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
TURNS = 20
CALLS = 50
TIMED_ROWS = 200
THRESHOLDS = tuple(range(400, 1000, 20))
"""Of the curves, thousandths."""


@dataclass(frozen=True)
class LearnerRow:
    """A learner trained on `thesis` and `broad`, and on the other styles alone.

    permille: its threshold. sets: figures by name. unseen: both unseen styles, together.
    left_out: the same for three learners, each trained without the style it is evaluated on.
    curve: the unseen styles at other thresholds.
    learner_us, step_us: median of the learner and of a whole step.
    """

    name: str
    learner: str
    permille: int
    sets: dict[str, Json]
    unseen: Json
    left_out: Json
    curve: list[Json]
    learner_us: float = 0.0
    step_us: float = 0.0


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_sets_option(parser)


def run(args: argparse.Namespace) -> int:
    """Study, write learner-streams.json, print the main columns."""
    require_writable(args.out)
    folder = sets_folder(args.sets, SETS, args.out)
    path = args.out / "learner-streams.json"

    def keep(rows: Sequence[LearnerRow]) -> None:
        content = [asdict(row) for row in rows]
        write_figures(path, {"kind": "simulated", "seed": args.seed, "rows": content})

    # kept after every learner: the study takes hours
    with stages(len(PLANS)) as say:
        rows = study(folder, args.seed, say, keep=keep)
    keep(rows)
    for row in rows:
        recall = row.unseen["recall"]
        sys.stdout.write(f"{recall:.3f} {row.step_us:6.1f} us  {row.name}\n")
    sys.stdout.write(f"{path}\n")
    return 0


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
    rows: list[LearnerRow] = []
    learners = {}
    for name, plan in plans.items():
        say(name)
        learners[name] = _fitted(plan, training_part(folder, VARIED), seed)
        rows.append(_row(name, plan, learners[name], folder, seed))
        keep(rows)
    us = _times_us(learners, _streams(folder, "author"))
    return [
        replace(row, learner_us=us[row.name][0], step_us=us[row.name][1])
        for row in rows
    ]


def _row(
    name: str, plan: TrainingPlan, learner: Learner, folder: Path, seed: int
) -> LearnerRow:
    answers = _answers(learner, folder, (CHOOSE, *EVALUATED))
    permille = _threshold(answers)
    found = {
        one: called(_streams(folder, one), answers[one], permille) for one in EVALUATED
    }
    here = {
        one: _figures(folder, [(one, result)], seed) for one, result in found.items()
    }
    return LearnerRow(
        name=name,
        learner=plan.learner,
        permille=permille,
        sets=here,
        unseen=_figures(folder, [(one, found[one]) for one in UNSEEN], seed),
        left_out=_figures(folder, _left_out(plan, folder, seed), seed),
        curve=_curve(answers, folder),
    )


def _left_out(
    plan: TrainingPlan, folder: Path, seed: int
) -> list[tuple[str, MethodResult]]:
    """Each style, and what a learner that was trained on the others calls on it."""
    results = []
    for style, others in STYLES_KEPT.items():
        learner = _fitted(plan, training_part(folder, others), seed)
        answers = _answers(learner, folder, (CHOOSE, style))
        results.append(
            (
                style,
                called(_streams(folder, style), answers[style], _threshold(answers)),
            )
        )
    return results


def _streams(folder: Path, name: str) -> Streams:
    return streams(folder / name, "natural", "default")


def _fitted(plan: TrainingPlan, part: Labelled, seed: int) -> Learner:
    return learner_of(plan, "classes", part.features, part.label, len(CLASSES), seed)


def _threshold(answers: Mapping[str, Sequence[Answers]]) -> int:
    """In thousandths of the votes, from streams of `daily`."""
    return choose_confidence(answers[CHOOSE], ONE_SAMPLE, MOST_FALSE_PER_MIN)


def _curve(answers: Mapping[str, Sequence[Answers]], folder: Path) -> list[Json]:
    """What each threshold would give on the unseen styles."""
    points = []
    for permille in THRESHOLDS:
        found = [
            called(_streams(folder, name), answers[name], permille) for name in UNSEEN
        ]
        result = together(found)
        scores = event_scores(result.matches, n_draws=0)
        share = float(np.mean([action.called for action in result.actions]))
        point = picked(scores, ("recall", "in_time", "false_per_min"))
        points.append({"permille": permille, **point, "called": share})
    return points


def _answers(
    learner: Learner, folder: Path, names: Sequence[str]
) -> dict[str, list[Answers]]:
    """The answers to every sample of some sets."""
    found = {}
    for name in names:
        here = _streams(folder, name)
        votes = reference_votes(learner, np.asarray(here.features), len(CLASSES))
        found[name] = answers_of(here, answer_of(votes))
    return found


def _figures(
    folder: Path, parts: Sequence[tuple[str, MethodResult]], seed: int
) -> Json:
    """Figures of one set, or of several together."""
    trials = [trial for name, _ in parts for trial in _streams(folder, name).trials]
    results = [result for _, result in parts]
    result = results[0] if len(results) == 1 else together(results)
    return picked(method_figures(result, trials, seed), KEPT)


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
