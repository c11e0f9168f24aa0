"""Points that share a learner: fitted, evaluated on unseen streams, exported for the hand."""

from __future__ import annotations

from collections.abc import Sequence
from copy import copy
from dataclasses import asdict, dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx

from benchmarks.cost.features import everywhere, windows
from benchmarks.cost.hands import HANDS, UNCHANGED, hand_figures
from benchmarks.cost.point import ON_HANDS, Point
from benchmarks.cost.recordings import per_recording, read
from holdfast.core.contract import RISKY_SLIP, FloatArray, Json
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules
from holdfast.evaluation.alarms import (
    Answers,
    EventMatch,
    EventScores,
    choose_confidence,
    event_scores,
    match_alarms,
    requests_at,
)
from holdfast.export.exporting import whole_graph
from holdfast.export.heads import Calibration, Head, riskier_argmax, situation_votes
from holdfast.export.learner import Forest, Learner, forest_of, reference_votes
from holdfast.export.network import IntArray
from holdfast.export.spec import StepSpec
from holdfast.training.crossval import (
    HeldOut,
    fit_calibration,
    fit_learner,
    joined_by_network,
    main_task,
)
from holdfast.training.featurise import FloatRows
from holdfast.training.figures import Interval, SituationFigures
from holdfast.training.fitting import held_out_figures
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, Recording, assign_groups

FOLDS = 3
MOST_FALSE_PER_MIN = 1.0


class Grown:
    """Learners of many sizes for the price of the largest: its first trees are the smaller forests.

    fit is as fit_learner, seed 0.
    """

    def __init__(self, n_trees: int) -> None:
        self._n_trees = n_trees
        self._largest: dict[bytes, Forest] = {}

    def fit(
        self,
        data: DataSet,
        features: FloatRows,
        plan: TrainingPlan,
        task: str,
        rows: IntArray,
    ) -> Learner:
        """The plan's learner on these rows."""
        if plan.learner == "network":
            return fit_learner(data, features, plan, task, rows, 0)
        key = rows.tobytes()
        if key not in self._largest:
            situation = replace(plan.situation, n_estimators=self._n_trees)
            largest = replace(plan, learner="forest", situation=situation)
            forest = forest_of(fit_learner(data, features, largest, task, rows, 0))
            assert forest is not None
            self._largest[key] = forest
        forest = first_trees(self._largest[key], plan.situation.n_estimators)
        if plan.learner == "forest":
            return forest
        given = data.tasks[task]
        label = given.label[rows]
        n_classes = len(given.classes)
        return joined_by_network(
            forest, plan, task, features[rows], label, n_classes, 0
        )


def first_trees(forest: Forest, n_trees: int) -> Forest:
    """The forest that a fit of so many trees would have been."""
    smaller = copy(forest).set_params(n_estimators=n_trees)
    smaller.estimators_ = forest.estimators_[:n_trees]
    return smaller


@dataclass(frozen=True)
class Voted:
    """Votes [T, K] of a learner at every sample of some unseen streams."""

    recordings: list[Recording]
    votes: list[IntArray]


@dataclass(frozen=True)
class Fitted:
    """A learner, its figures on unseen windows, its calibration, and its votes.

    of: pairs (streams to choose a threshold on, streams to evaluate at it); one pair for scenes, a
    pair per fold for people. on_hands: the streams to evaluate on, felt by other hands.
    """

    learner: Learner
    figures: SituationFigures
    calibration: Calibration
    of: list[tuple[Voted, Voted]]
    on_hands: dict[str, Voted] = field(default_factory=dict)


@dataclass(frozen=True)
class PointFigures:
    """Figures of a point on unseen recordings.

    macro_f1: over four situations at windows. permille: the least confidence, one for each pair of
    streams. hands: of points that are asked on other hands, the figures of each.
    """

    point: Point
    macro_f1: float | None
    macro_f1_ci: Interval | None
    events: EventScores
    permille: list[int]
    hands: Json | None = None

    def to_json(self) -> Json:
        """As it stands in the file of the point."""
        windows = {"macro_f1": self.macro_f1, "macro_f1_ci": self.macro_f1_ci}
        figures = windows | asdict(self.events) | {"permille": self.permille}
        on_hands = {"hands": self.hands}
        return asdict(self.point) | {"what": self.point.what} | figures | on_hands


def measure(
    point: Point, points: Sequence[Point], folder: Path, grown: Grown
) -> tuple[list[PointFigures], onnx.ModelProto]:
    """Figures of points that have the learner of this one, and its step graph."""
    data = read(folder, point.of, point.rate_hz, "train")
    fitted = (_people if point.of == "human" else _grasps)(point, folder, data, grown)
    head = Head(
        "situation",
        data.tasks[main_task(data)].classes,
        fitted.learner,
        fitted.calibration,
    )
    return [_decided(one, fitted, point.spec(data)) for one in points], whole_graph(
        point.spec(data), [head]
    )


def _grasps(point: Point, folder: Path, data: DataSet, grown: Grown) -> Fitted:
    """Scenes: threshold and calibration from one stream of grasps, figures from another."""
    every = np.arange(len(data.tasks["classes"]))
    learner = grown.fit(data, windows(folder, point), point.plan, "classes", every)
    (chosen_on, choosing), (evaluated, asking) = (
        _voted(point, folder, part, learner) for part in ("choose", "ask")
    )
    calibration = fit_calibration(
        _held_out(chosen_on, choosing).shares("classes"),
        choosing.tasks["classes"].label,
    )
    figures = held_out_figures(asking, _held_out(evaluated, asking)).situations
    on_hands = {
        name: _voted(point, folder, f"ask, {name}", learner)[0]
        for name in (HANDS if point in ON_HANDS else ())
    }
    return Fitted(learner, figures, calibration, [(chosen_on, evaluated)], on_hands)


def _people(point: Point, folder: Path, data: DataSet, grown: Grown) -> Fitted:
    """People: each is evaluated by a learner trained without them.

    The threshold is chosen on the people of other folds. The learner that is timed is the first
    fold's.
    """
    features = windows(folder, point)
    task = data.tasks["situations"]
    folds = assign_groups(data.group_of("situations"), FOLDS)
    of_window = np.array([folds[str(group)] for group in data.group_of("situations")])
    rows = per_recording(data, everywhere(folder, point, "train"))
    learners = [
        grown.fit(
            data, features, point.plan, "situations", np.flatnonzero(of_window != fold)
        )
        for fold in range(FOLDS)
    ]
    votes: dict[int, IntArray] = {}
    for fold, learner in enumerate(learners):
        which = _of_fold(data, folds, fold)
        votes |= zip(
            which,
            _votes(learner, [rows[k] for k in which], len(task.classes)),
            strict=True,
        )
    evaluated = [_of(data, votes, _of_fold(data, folds, fold)) for fold in range(FOLDS)]
    others = [
        _of(
            data,
            votes,
            [k for k in range(len(rows)) if k not in set(_of_fold(data, folds, fold))],
        )
        for fold in range(FOLDS)
    ]
    held = _held_out(_of(data, votes, range(len(rows))), data)
    calibration = fit_calibration(held.shares("situations"), task.label)
    figures = held_out_figures(data, held).situations
    return Fitted(
        learners[0], figures, calibration, list(zip(others, evaluated, strict=True))
    )


def _held_out(voted: Voted, data: DataSet) -> HeldOut:
    """The votes at the labelled windows of all recordings."""
    task = main_task(data)
    rows = data.tasks[task]
    return HeldOut(
        {
            task: np.array(
                [voted.votes[t][r] for t, r in zip(rows.trial, rows.row, strict=True)]
            )
        }
    )


def _of_fold(data: DataSet, folds: dict[str, int], fold: int) -> list[int]:
    """Places of the recordings of a fold's people."""
    return [k for k, one in enumerate(data.recordings) if folds[one.group] == fold]


def _of(data: DataSet, votes: dict[int, IntArray], which: Sequence[int]) -> Voted:
    return Voted([data.recordings[k] for k in which], [votes[k] for k in which])


def _voted(
    point: Point, folder: Path, part: str, learner: Learner
) -> tuple[Voted, DataSet]:
    data = read(folder, point.of, point.rate_hz, part)
    votes = reference_votes(
        learner, everywhere(folder, point, part), len(data.tasks["classes"].classes)
    )
    return Voted(list(data.recordings), per_recording(data, votes)), data


def _votes(
    learner: Learner, rows: Sequence[FloatRows], n_classes: int
) -> list[IntArray]:
    """Votes on all recordings at once, since counting leaf votes is slow and running is fast."""
    ends = np.cumsum([len(one) for one in rows])
    return np.split(
        reference_votes(learner, np.concatenate(rows), n_classes), ends[:-1]
    )


def _decided(point: Point, fitted: Fitted, spec: StepSpec) -> PointFigures:
    """Figures of the votes with a point's decision."""
    matches = []
    chosen = []
    for choose, ask in fitted.of:
        there, here = (
            _answers(point, voted, fitted.calibration, spec) for voted in (choose, ask)
        )
        chosen.append(choose_confidence(there, point.rules, MOST_FALSE_PER_MIN))
        matches += _matches(here, point.rules, chosen[-1])
    hands = None
    if point in ON_HANDS:
        hands = {UNCHANGED: hand_figures(matches)}
        for name, voted in fitted.on_hands.items():
            here = _answers(point, voted, fitted.calibration, spec)
            felt = _matches(here, point.rules, chosen[-1])
            hands[name] = hand_figures(felt)
    f1, f1_ci = fitted.figures.macro_f1, fitted.figures.macro_f1_ci
    return PointFigures(point, f1, f1_ci, event_scores(matches), chosen, hands)


def _matches(
    answers: Sequence[Answers], rules: DecisionRules, permille: int
) -> list[EventMatch]:
    """The events of answered streams, acted on from one confidence on."""
    requests = requests_at(answers, rules, permille)
    pairs = zip(answers, requests, strict=True)
    return [match_alarms(one.recording, on) for one, on in pairs]


def _answers(
    point: Point, voted: Voted, calibration: Calibration, spec: StepSpec
) -> list[Answers]:
    answers = []
    for recording, votes in zip(voted.recordings, voted.votes, strict=True):
        by_situation = situation_votes(votes)
        situation = riskier_argmax(by_situation)
        situation[: spec.settle_samples - 1] = UNKNOWN
        usable = recording.valid.sum(axis=1)
        situation[usable < spec.min_valid_sensors] = UNKNOWN
        risky = (
            _probability(votes, calibration)
            if point.confidence == "calibrated"
            else (by_situation[:, RISKY_SLIP] / by_situation.sum(axis=1))
        )
        answers.append(Answers(recording, situation, (1000 * risky).astype(np.int64)))
    return answers


def _probability(votes: IntArray, calibration: Calibration) -> FloatArray:
    """[T] calibrated probability of a risky slip, light or heavy."""
    logits = (
        votes / votes.sum(axis=1, keepdims=True) @ calibration.weights
        + calibration.bias
    )
    odds = np.exp(logits - logits.max(axis=1, keepdims=True))
    risky: npt.NDArray[Any] = situation_votes(odds / odds.sum(axis=1, keepdims=True))[
        :, RISKY_SLIP
    ]
    return risky
