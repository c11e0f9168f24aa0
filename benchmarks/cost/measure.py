"""One point: fitted, asked about whole streams that it never met, and written as a file for the hand."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt
import onnx

from benchmarks.cost import sets
from benchmarks.cost.point import Point
from edge_runtime.contract import RISKY_SLIP, FloatArray
from edge_runtime.decision import UNKNOWN
from export.exporting import whole_graph
from export.forest import Forest
from export.heads import Calibration, Head
from export.reference import IntArray, reference_votes, riskier_argmax, situation_votes
from training.alarms import Answers
from training.crossval import HeldOut, cross_validate, fit_calibration, fit_forest, main_task
from training.event_scores import choose_confidence, event_scores, hear
from training.featurise import FloatRows
from training.fitting import held_out_figures
from training.recording import DataSet
from training.splits import assign_groups

FOLDS = 3
MOST_FALSE_PER_MIN = 1.0
Features = dict[str, FloatRows]


def measure(point: Point, folder: Path) -> tuple[dict[str, Any], onnx.ModelProto]:
    """Figures of a point, and its whole step graph."""
    data = sets.read(folder, point.of, point.rate_hz, "train")
    features, plan, task = sets.windows(folder, point), point.plan(FOLDS), main_task(data)
    forest = fit_forest(data, features[task], plan, task, np.arange(len(data.tasks[task])), 0)
    asked = _people if point.of == "human" else _grasps
    held, calibration, heard = asked(point, folder, data, features, forest)
    situations = held_out_figures(data, held)["situations"]
    told = {"macro_f1": situations["macro_f1"], "macro_f1_ci": situations["macro_f1_ci"]}
    head = Head("situation", data.tasks[task].classes, forest, calibration)
    return told | heard, whole_graph(point.spec(data), [head])


def _grasps(
    point: Point, folder: Path, data: DataSet, features: Features, forest: Forest
) -> tuple[HeldOut, Calibration, dict[str, Any]]:
    """Scenes: the threshold is chosen on one stream of grasps, and the point asked about another."""
    held = cross_validate(data, features, point.plan(FOLDS))
    calibration = fit_calibration(held.shares("classes"), data.tasks["classes"].label)
    chosen_on, asked = (_answers(point, folder, part, forest, calibration) for part in ("choose", "ask"))
    permille = choose_confidence(chosen_on, point.rules, MOST_FALSE_PER_MIN)
    return held, calibration, event_scores(hear(asked, point.rules, permille)) | {"permille": [permille]}


def _people(
    point: Point, folder: Path, data: DataSet, features: Features, forest: Forest
) -> tuple[HeldOut, Calibration, dict[str, Any]]:
    """People: each is asked by a forest that never met him, at a threshold chosen on the people of other folds."""
    task, plan = data.tasks["situations"], point.plan(FOLDS)
    folds = assign_groups(data.group_of("situations"), FOLDS)
    of_window = np.array([folds[str(group)] for group in data.group_of("situations")])
    rows = sets.per_recording(data, sets.everywhere(folder, point, "train"))
    votes: list[IntArray] = [np.empty((0, 4), np.int64)] * len(rows)
    for fold in range(FOLDS):
        met = fit_forest(data, features["situations"], plan, "situations", np.flatnonzero(of_window != fold), 0)
        for k in _of_fold(data, folds, fold):
            votes[k] = reference_votes(met, np.asarray(rows[k]), 4)
    held = HeldOut({"situations": np.array([votes[t][r] for t, r in zip(task.trial, task.row, strict=True)])})
    calibration = fit_calibration(held.shares("situations"), task.label)
    answers = [_answered(point, data, which := _of_fold(data, folds, fold), [votes[k] for k in which], calibration)
               for fold in range(FOLDS)]  # fmt: skip
    heard, chosen = [], []
    for fold in range(FOLDS):
        others = [one for k, part in enumerate(answers) if k != fold for one in part]
        chosen.append(choose_confidence(others, point.rules, MOST_FALSE_PER_MIN))
        heard += hear(answers[fold], point.rules, chosen[-1])
    return held, calibration, event_scores(heard) | {"permille": chosen}


def _of_fold(data: DataSet, folds: dict[str, int], fold: int) -> list[int]:
    """Places of the recordings of a fold's people."""
    return [k for k, one in enumerate(data.recordings) if folds[one.group] == fold]


def _answers(point: Point, folder: Path, part: str, forest: Forest, calibration: Calibration) -> list[Answers]:
    data = sets.read(folder, point.of, point.rate_hz, part)
    rows = sets.per_recording(data, sets.everywhere(folder, point, part))
    votes = [reference_votes(forest, np.asarray(one), len(data.tasks["classes"].classes)) for one in rows]
    return _answered(point, data, list(range(len(rows))), votes, calibration)


def _answered(
    point: Point, data: DataSet, which: list[int], votes: list[IntArray], calibration: Calibration
) -> list[Answers]:
    settle = point.spec(data).settle_samples - 1
    answers = []
    for k, voted in zip(which, votes, strict=True):
        by_situation = situation_votes(voted)
        situation = riskier_argmax(by_situation)
        situation[:settle] = UNKNOWN
        risky = _probability(voted, calibration) if point.confidence == "calibrated" else (
            by_situation[:, RISKY_SLIP] / by_situation.sum(axis=1)
        )  # fmt: skip
        answers.append(Answers(data.recordings[k], situation, (1000 * risky).astype(np.int64)))
    return answers


def _probability(votes: IntArray, calibration: Calibration) -> FloatArray:
    """[T] calibrated probability of a risky slip, light or heavy."""
    logits = votes / votes.sum(axis=1, keepdims=True) @ calibration.weights + calibration.bias
    odds = np.exp(logits - logits.max(axis=1, keepdims=True))
    risky: npt.NDArray[Any] = situation_votes(odds / odds.sum(axis=1, keepdims=True))[:, RISKY_SLIP]
    return risky


def rows_for_timing(point: Point, folder: Path, count: int) -> FloatRows:
    """Some of the rows that were asked about, as the step hands them to the forest."""
    rows = sets.everywhere(folder, point, "train" if point.of == "human" else "ask")
    return np.array(rows[:: max(1, len(rows) // count)][:count])
