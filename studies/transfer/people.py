"""Models trained on scenes alone, scored on people: human_slip_uskin, 18 channels.

Learner, features and tasks are those of `make real`; only the windows that they learn from differ.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace

import numpy as np

from holdfast.core.contract import (
    GRASP,
    RISKY_SLIP,
    SITUATIONS,
    FloatArray,
    IntArray,
)
from holdfast.core.reading import Json
from holdfast.evaluation.jobs import Workers
from holdfast.export.heads import riskier_argmax
from holdfast.export.learner import Learner, reference_votes
from holdfast.training.crossval import HeldOut, fit_learner
from holdfast.training.datasets.human_slip_labels import (
    HORIZON_ROWS,
    PREDICTION_STEP_ROWS,
)
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.metrics import prediction_scores, report, share_scores
from holdfast.training.plan import TrainingPlan, hand_plan
from holdfast.training.progress import Say
from holdfast.training.recording import DataSet, LabelledRows, Recording
from studies.real.methods import METHODS, OURS, cross_validated
from studies.row_names import CLOCK, OURS_18
from studies.transfer.levels import at_level, levels

PLAN = TrainingPlan()
"""Of `make real`: chosen on these people once, before this study, and not changed for it."""
SHIPPED_PLAN = hand_plan("default")
"""Of the shipped models."""
NO_EVERY_ROWS = 12
"""Between two simulated rows without a slip ahead; there are plenty, and classes weigh the same."""
AS_RECORDED, OWN_LEVEL = "as recorded", "own level"
REAL_ONLY = "people alone, each left out"
TIMING = "timing-only baseline"


@dataclass(frozen=True)
class Trained:
    """Learners of both tasks from one set of scenes. level_n: the scenes' own level."""

    plan: TrainingPlan
    learners: dict[str, Learner]
    level_n: float
    windows: dict[str, dict[str, int]]


def real_rows(seed: int, workers: Workers, say: Say) -> list[Json]:
    """Real-only and the timing baseline, people left out: the folds of `make real`."""
    methods = {
        OURS_18: replace(OURS, verified=False),
        CLOCK: METHODS[CLOCK],
    }
    rows = cross_validated(methods, seed, workers, say)
    data = OURS.data()
    names = {OURS_18: REAL_ONLY, CLOCK: TIMING}
    return [
        _row(names[name], AS_RECORDED, data, _answers(row.held_out), seed)
        for name, row in rows.items()
    ]


def like_people(data: DataSet) -> DataSet:
    """Scenes with the two tasks of the people: four situations, and the 0.25 s prediction.

    A simulated grasp that still holds, or slips but not yet as a whole, is asked whether gross slip
    comes within 0.25 s; people are asked the same below 5 degrees about 15 degrees.
    """
    classes = data.tasks["classes"]
    situations = replace(
        classes,
        label=classes.label // (len(classes.classes) // len(SITUATIONS)),
        classes=SITUATIONS,
    )
    parts = []
    for number, recording in enumerate(data.recordings):
        row, label = prediction_rows(recording)
        parts.append(LabelledRows(np.full(len(row), number), row, label, ("no", "yes")))
    predicted = LabelledRows.concatenated(parts)
    return replace(data, tasks={"situations": situations, "predict_250ms": predicted})


def prediction_rows(recording: Recording) -> tuple[IntArray, IntArray]:
    """Rows of a simulated trial that hold, and whether gross slip comes within 0.25 s."""
    n = len(recording.samples)
    held = np.zeros(n, np.bool_)
    for phase in recording.phases:
        held[phase.first : phase.stop] = phase.situation == GRASP
    gross = np.zeros(n + 1, np.int64)
    for event in recording.events:
        last_s = event.end_s if event.gross_s is None else event.gross_s
        onset, last = np.rint(
            np.array([event.onset_s, last_s]) * recording.rate_hz
        ).astype(np.int64)
        held[onset:last] = True
        gross[min(last, n - 1) + 1] = 1
    settled = round(0.5 * recording.rate_hz)
    row = np.arange(settled, n - 1, PREDICTION_STEP_ROWS)
    row = row[held[row]]
    # gross slips up to a row: more at the end of the horizon than at its start
    so_far = np.cumsum(gross)
    end = np.minimum(row + HORIZON_ROWS, n - 1) + 1
    soon = so_far[end] > so_far[row + 1]
    kept = soon | (row % NO_EVERY_ROWS < PREDICTION_STEP_ROWS)
    return row[kept], soon[kept].astype(np.int64)


def train(
    data: DataSet,
    rate_hz: float,
    plan: TrainingPlan,
    seed: int,
    tasks: Sequence[str] = ("situations", "predict_250ms"),
) -> Trained:
    """Fit a plan on scenes. rate_hz: of the people, whose step makes the features."""
    data = like_people(replace(data, rate_hz=rate_hz))
    data = replace(data, tasks={task: data.tasks[task] for task in tasks})
    features = features_of(data, spec_for(data, plan.groups))
    every = {task: np.arange(len(rows)) for task, rows in data.tasks.items()}
    learners = {
        task: fit_learner(data, features[task], plan, task, every[task], seed)
        for task in data.tasks
    }
    counts = {task: rows.class_counts() for task, rows in data.tasks.items()}
    return Trained(plan, learners, levels(data, by_group=False)[""], counts)


def reported_on(people: DataSet) -> DataSet:
    """Every second person by name, the second first: the others are those to choose on."""
    return people.of_groups(set(sorted(people.groups())[1::2]))


def scene_rows(name: str, model: Trained, people: DataSet, seed: int) -> list[Json]:
    """The rows of a model on people, in their own newtons and by their own level."""
    rows = []
    for scaling in (AS_RECORDED, OWN_LEVEL):
        data = people
        if scaling == OWN_LEVEL:
            data = at_level(people, model.level_n)
        row = _row(name, scaling, data, _votes(model, data), seed)
        rows.append(row | {"windows": model.windows, "level_n": model.level_n})
    return rows


def _votes(model: Trained, people: DataSet) -> _Answers:
    features = features_of(people, spec_for(people, model.plan.groups))
    votes = {}
    for task, learner in model.learners.items():
        n_classes = len(people.tasks[task].classes)
        votes[task] = reference_votes(learner, features[task], n_classes)
    of_situations = reference_votes(
        model.learners["situations"], features["predict_250ms"], len(SITUATIONS)
    )
    soon = None
    if "predict_250ms" in votes:
        soon = _share(votes["predict_250ms"], 1)
    situations = riskier_argmax(votes["situations"])
    return _Answers(situations, soon, _share(of_situations, RISKY_SLIP))


@dataclass(frozen=True)
class _Answers:
    """situations [M]; soon [K]: score of the prediction head; risky [K]: share of risky votes.

    None where a model has no such head.
    """

    situations: IntArray
    soon: FloatArray | None
    risky: FloatArray | None = None


def _answers(held_out: HeldOut) -> _Answers:
    return _Answers(held_out.situations(), held_out.shares("predict_250ms")[:, 1])


def _share(votes: IntArray, of: int) -> FloatArray:
    shares: FloatArray = votes[:, of] / votes.sum(axis=1)
    return shares


def _row(
    name: str, scaling: str, people: DataSet, answers: _Answers, seed: int
) -> Json:
    """Every figure of one row, with intervals over people."""
    figures = report(people, answers.situations, answers.soon, seed=seed)
    truth = people.tasks["situations"].label
    groups = people.group_of("situations")
    recall = {}
    for label, situation in enumerate(SITUATIONS):
        here = truth == label
        found = share_scores(answers.situations[here] == label, groups[here], seed=seed)
        recall[situation] = asdict(found)
    row = {"row": name, "scaling": scaling, "recall": recall} | figures.to_json()
    if answers.risky is not None:
        task = people.tasks["predict_250ms"].label
        by_risky = prediction_scores(
            task, answers.risky, people.group_of("predict_250ms"), seed=seed
        )
        row["by_risky_votes"] = asdict(by_risky)
    return row


def named(rows: Sequence[Json], name: str, scaling: str) -> Json | None:
    """The row of that name and scaling."""
    for row in rows:
        if (row["row"], row["scaling"]) == (name, scaling):
            return row
    return None
