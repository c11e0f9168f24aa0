"""Points with the same features: fitted, evaluated on unseen streams, exported for the hand."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np
import onnx

from benchmarks.cost.hands import HANDS, UNCHANGED, hand_figures, on_hand
from benchmarks.cost.point import ON_HANDS, Point
from benchmarks.cost.recordings import read
from holdfast.core.contract import RISKY_SLIP, FloatArray, IntArray, Json
from holdfast.data.recording import DataSet, Recording, assign_groups
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.alarms import (
    EventMatch,
    RecordingAnswers,
    choose_confidence,
    event_scores,
    match_alarms,
    requests_at,
)
from holdfast.evaluation.model_outputs import every_row
from holdfast.export.exporting import whole_graph
from holdfast.step.features import SCALED_LAGS, SPANS_S, feature_count
from holdfast.step.heads import Head, riskier_argmax, situation_votes
from holdfast.step.history import LAGS_S
from holdfast.step.learner import Learner, reference_votes
from holdfast.step.pooled import side_matrix
from holdfast.step.spec import StepSpec
from holdfast.training.crossval import (
    FloatRows,
    HeldOut,
    features_at,
    features_of,
    fit_learner,
    main_task,
    spec_for,
    uncalibrated,
)
from holdfast.training.judging import held_out_figures

FOLDS = 3
MOST_FALSE_PER_MIN = 1.0
Votes = list[IntArray]
"""[T, K] of a learner at every sample of some recordings."""


@dataclass(frozen=True)
class Stream:
    """One recording and the votes [T, K] of a learner that never saw it."""

    recording: Recording
    votes: IntArray


@dataclass(frozen=True)
class Fitted:
    """A learner, its macro F1 with interval on unseen windows, and its votes.

    streams: pairs (to choose a threshold on, to evaluate at it); one pair for scenes, a pair per
    fold for people. on_hands: the streams to evaluate on, felt by other hands.
    """

    learner: Learner
    windows: Json
    streams: list[tuple[list[Stream], list[Stream]]]
    on_hands: dict[str, list[Stream]] = field(default_factory=dict)


@dataclass(frozen=True)
class Measured:
    """Figures of points that share a learner, and its step graph."""

    rows: dict[Point, Json]
    model: onnx.ModelProto


def measure(points: Sequence[Point], folder: Path) -> dict[Point, Measured]:
    """Learner's point -> what is found of its points; all points have the same features."""
    data = read(folder, points[0], "train")
    spec = points[0].spec(data)
    learners = list(dict.fromkeys(point.fitted for point in points))
    fit = _on_people if points[0].of == "human" else _on_scenes
    found = {}
    for point, fitted in fit(learners, folder, data).items():
        alike = [one for one in points if one.fitted == point]
        rows = {one: _figures(one, fitted, spec) for one in alike}
        classes = data.tasks[main_task(data)].classes
        calibration = uncalibrated(len(classes))
        head = Head("situation", classes, fitted.learner, calibration)
        found[point] = Measured(rows, whole_graph(spec, [head]))
    return found


def _on_scenes(
    points: Sequence[Point], folder: Path, data: DataSet
) -> dict[Point, Fitted]:
    """Scenes: the threshold from some streams of grasps, figures from others."""
    spec = points[0].spec(data)
    windows = features_of(data, spec)["classes"]
    every = np.arange(len(windows))
    learners = {}
    for point in points:
        rows = seen(windows, spec, point.look_back_s)
        learners[point] = fit_learner(data, rows, point.plan, "classes", every, 0)

    choosing = read(folder, points[0], "choose")
    evaluated = read(folder, points[0], "ask")
    choose = _votes(learners, choosing)
    ask = _votes(learners, evaluated)
    thumb = side_matrix(spec_for(evaluated, ("now",)))[:, 0] > 0.0
    hands = {name: on_hand(evaluated, name, thumb) for name in HANDS}
    asked = {point: one for point, one in learners.items() if point in ON_HANDS}
    felt = {name: _votes(asked, hands[name]) for name in HANDS if asked}

    found = {}
    for point, learner in learners.items():
        streams = (_streams(choosing, choose[point]), _streams(evaluated, ask[point]))
        on_hands = {
            name: _streams(hands[name], votes[point])
            for name, votes in felt.items()
            if point in asked
        }
        figures = _window_figures(evaluated, ask[point])
        found[point] = Fitted(learner, figures, [streams], on_hands)
    return found


def _on_people(
    points: Sequence[Point], folder: Path, data: DataSet
) -> dict[Point, Fitted]:
    """People: each is evaluated by a learner trained without them.

    The threshold is chosen on the people of other folds. The learner that is timed is the first
    fold's.
    """
    spec = points[0].spec(data)
    windows = features_of(data, spec)["situations"]
    everywhere = features_at(data, spec, every_row(data.recordings))
    groups = data.group_of("situations")
    folds = assign_groups(groups, FOLDS)
    fold_of_window = np.array([folds[str(group)] for group in groups])
    fold_of = np.array([folds[one.group] for one in data.recordings])
    found = {}
    for point in points:
        rows = seen(windows, spec, point.look_back_s)
        learners = []
        for fold in range(FOLDS):
            train = np.flatnonzero(fold_of_window != fold)
            learner = fit_learner(data, rows, point.plan, "situations", train, 0)
            learners.append(learner)

        votes: Votes = [np.empty(0, np.int64) for _ in everywhere]
        for fold, learner in enumerate(learners):
            inside = np.flatnonzero(fold_of == fold)
            theirs = [seen(everywhere[k], spec, point.look_back_s) for k in inside]
            counted = _votes_of(learner, theirs, len(data.tasks["situations"].classes))
            for k, of_recording in zip(inside, counted, strict=True):
                votes[k] = of_recording

        streams = _streams(data, votes)
        pairs = []
        for fold in range(FOLDS):
            others = [streams[k] for k in np.flatnonzero(fold_of != fold)]
            pairs.append(
                (others, [streams[k] for k in np.flatnonzero(fold_of == fold)])
            )
        figures = _window_figures(data, votes)
        found[point] = Fitted(learners[0], figures, pairs)
    return found


def _votes(learners: dict[Point, Learner], data: DataSet) -> dict[Point, Votes]:
    """What learners of the same features vote at every sample; features are computed once."""
    if not learners:
        return {}
    spec = next(iter(learners)).spec(data)
    each = features_at(data, spec, every_row(data.recordings))
    n_classes = len(data.tasks["classes"].classes)
    votes = {}
    for point, learner in learners.items():
        rows = [seen(features, spec, point.look_back_s) for features in each]
        votes[point] = _votes_of(learner, rows, n_classes)
    return votes


def _votes_of(learner: Learner, each: Sequence[FloatRows], n_classes: int) -> Votes:
    # All recordings at once: counting the votes of leaves is slow, running is fast.
    ends = np.cumsum([len(rows) for rows in each])[:-1]
    return np.split(reference_votes(learner, np.concatenate(each), n_classes), ends)


def _streams(data: DataSet, votes: Votes) -> list[Stream]:
    pairs = zip(data.recordings, votes, strict=True)
    return [Stream(recording, of) for recording, of in pairs]


def _window_figures(data: DataSet, votes: Votes) -> Json:
    """Macro F1 over four situations at the labelled windows, with its interval."""
    task = main_task(data)
    windows = data.tasks[task]
    places = zip(windows.trial, windows.row, strict=True)
    at_windows = np.array([votes[trial][row] for trial, row in places])
    figures = held_out_figures(data, HeldOut({task: at_windows})).situations
    return {"macro_f1": figures.macro_f1, "macro_f1_ci": figures.macro_f1_ci}


def _figures(point: Point, fitted: Fitted, spec: StepSpec) -> Json:
    """The row of a point: its fitted learner with its decision."""
    matches = []
    permille = []
    for choose, ask in fitted.streams:
        least = choose_confidence(
            _answers(choose, spec), point.rules, MOST_FALSE_PER_MIN
        )
        matches += _matches(point, ask, spec, least)
        permille.append(least)

    hands = None
    if point in ON_HANDS:
        hands = {UNCHANGED: hand_figures(matches)}
        for name, streams in fitted.on_hands.items():
            of_hand = _matches(point, streams, spec, permille[0])
            hands[name] = hand_figures(of_hand)
    events = asdict(event_scores(matches))
    chosen = {"what": point.what, **asdict(point), "permille": permille}
    return {**chosen, **fitted.windows, **events, "hands": hands}


def _matches(
    point: Point, streams: Sequence[Stream], spec: StepSpec, permille: int
) -> list[EventMatch]:
    """The events of streams, acted on from one confidence on."""
    answers = _answers(streams, spec)
    requests = requests_at(answers, point.rules, permille)
    pairs = zip(answers, requests, strict=True)
    return [match_alarms(one.recording, on) for one, on in pairs]


def _answers(streams: Sequence[Stream], spec: StepSpec) -> list[RecordingAnswers]:
    answers = []
    for one in streams:
        votes = situation_votes(one.votes)
        situation = riskier_argmax(votes)
        situation[: spec.settle_samples - 1] = UNKNOWN
        usable = one.recording.valid.sum(axis=1)
        situation[usable < spec.min_valid_sensors] = UNKNOWN
        share = votes[:, RISKY_SLIP] / votes.sum(axis=1)
        permille = (1000 * share).astype(np.int64)
        answers.append(RecordingAnswers(one.recording, situation, permille))
    return answers


def seen(rows: FloatRows, spec: StepSpec, look_back_s: float) -> FloatRows:
    """The rows, features that look further back made constant, so that no tree uses them."""
    beyond = look_backs_s(spec) > look_back_s + 1e-9
    return np.where(beyond, np.float32(0.0), rows) if beyond.any() else rows


def look_backs_s(spec: StepSpec) -> FloatArray:
    """[F]: how far back each feature of single fingers looks; 0 for the others."""
    lags = np.array(LAGS_S)
    known = {
        "differences": np.tile(np.repeat(lags, 3), spec.n_sensors),
        "scaled_differences": np.tile(
            np.repeat(lags[list(SCALED_LAGS)], 3), spec.n_sensors
        ),
        "scaled_sums": np.repeat(lags, 3),
        "activity": np.repeat(np.array(SPANS_S), 3),
    }
    parts = []
    for name in spec.groups:
        width = feature_count(
            StepSpec(spec.n_sensors, spec.rate_hz, spec.unit, (name,))
        )
        parts.append(known.get(name, np.zeros(width)))
    return np.concatenate(parts)
