"""Files for two pads that have learned from some of the people, to be answered by for the others.

The sets are split as training splits them, into five folds: each holds out two people, and a fifth
of the scenes. A window's held-out votes come from the learner that held it out, so the calibration
of a file is fitted on votes for windows that its own people are not among.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from holdfast.core.hand_card import read_hand_card
from holdfast.core.locked import require_open_people
from holdfast.core.progress import Stages
from holdfast.core.writing import write_whole
from holdfast.data.datasets import load
from holdfast.data.datasets.grip_lift_ati import NAME as LIFTS
from holdfast.data.datasets.joining import join
from holdfast.data.recording import DataSet, Fold, learnable
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.export.changed import changed
from holdfast.export.exporting import export_artifact
from holdfast.step.artifact import Artifact, write_artifact
from holdfast.step.heads import Calibration, Head
from holdfast.step.learner import Learner
from holdfast.step.network import IntArray
from holdfast.training.crossval import (
    FloatRows,
    HeldOut,
    answer_fold,
    fit_calibration,
    fit_learner,
    main_task,
    spec_for,
    splits_of,
    uncalibrated,
    window_counts,
    with_even_classes,
)
from holdfast.training.fitting import with_features
from holdfast.training.plan import TASK_HEADS, TrainingPlan

FOLDS = 5
QUICK_PEOPLE, QUICK_RECORDINGS = 2, 8
"""People, and recordings of each, where only the way is tried."""


@dataclass(frozen=True)
class Study:
    """What the folds share. data, features: of all windows; sets: as they were read; streams: the
    lifts, whole, the last of them.
    """

    data: DataSet
    features: FloatRows
    sets: tuple[DataSet, ...]
    streams: DataSet
    plan: TrainingPlan
    seed: int

    @property
    def task(self) -> str:
        """The eight classes."""
        return main_task(self.data)

    @property
    def lifts(self) -> DataSet:
        """The part of the lifts."""
        return self.data.parts[-1]


@dataclass(frozen=True)
class FoldFile:
    """A model file for two pads, and the people whom it has not learned from."""

    path: Path
    people: tuple[str, ...]


def read_study(
    sets: Sequence[str],
    plan: TrainingPlan,
    rate_hz: float,
    seed: int,
    say: Stages,
    *,
    quick: bool = False,
) -> Study:
    """Read all sets, the lifts last, and compute the features of every window once.

    quick: two people alone, and eight recordings of each.
    """
    loaded = []
    for name in sets:
        say(f"reading {name}")
        data = load(name, rate_hz=rate_hz, windows="dense", seed=seed)
        require_open_people(data.name, data.people(), "a model")
        if data.name == LIFTS and quick:
            data = few_recordings(data)
        loaded.append(data)
    streams = loaded[-1]
    joined = learnable(join(loaded, several_hands=True))
    folds = min(FOLDS, len(streams.people()))
    plan = replace(plan, folds=folds)
    data, features = with_features(joined, plan, seed, say, say.part)
    return Study(data, features[main_task(data)], tuple(loaded), streams, plan, seed)


def few_recordings(data: DataSet, most: int = QUICK_RECORDINGS) -> DataSet:
    """Two people of a set, and at most so many recordings of each."""
    index: list[int] = []
    for person in data.people()[:QUICK_PEOPLE]:
        theirs = [k for k, one in enumerate(data.recordings) if one.group == person]
        index += theirs[:most]
    kept = [data.recordings[k] for k in index]
    tasks = {task: rows.of_trials(index) for task, rows in data.tasks.items()}
    return replace(data, recordings=kept, tasks=tasks)


def fold_files(study: Study, out: Path, say: Stages) -> list[FoldFile]:
    """A file of each fold, which has learned from no lift of the people that it holds out."""
    data, task = study.data, study.task
    splits = splits_of(data, study.plan, study.seed)
    answers = []
    for number, split in enumerate(splits, 1):
        say(f"fold {number} of {len(splits)}")
        features = {task: study.features}
        answers.append(answer_fold(data, features, study.plan, split, study.seed))
    held_out = HeldOut.of(data, answers)

    files = []
    for number, (split, answer) in enumerate(zip(splits, answers, strict=True), 1):
        train, _ = split[task]
        learner = answer.learners[task]
        calibration = _calibration(study, held_out, train)
        path = _file(study, learner, calibration, split[task], out / f"fold-{number}")
        files.append(FoldFile(path, _people_without(study, train)))
    return files


def for_hand(model: Path, hand: str, folder: Path) -> Path:
    """The same learner for another hand, by the name of its card, in a folder."""
    data = changed(read_sealed(model), read_hand_card(hand), {}, model)
    return write_whole(folder / f"{model.stem}-{hand}.onnx", data)


def scenes_file(study: Study, out: Path, say: Stages) -> Path:
    """A file of the first fold's scenes alone, two-pad scenes among them, and of no person."""
    say("scenes alone")
    train, test = splits_of(study.data, study.plan, study.seed)[0][study.task]
    train = train[study.data.set_of(study.task)[train] != LIFTS]
    learner = fit_learner(
        study.data, study.features, study.plan, study.task, train, study.seed
    )
    # alarms are made of votes, so probabilities are not needed
    calibration = uncalibrated(len(study.data.tasks[study.task].classes))
    return _file(study, learner, calibration, (train, test), out / "scenes")


def _calibration(study: Study, held_out: HeldOut, train: IntArray) -> Calibration:
    """Of a fold's learner, on the held-out votes of the windows that it was trained on."""
    label = study.data.tasks[study.task].label[train]
    names = study.data.set_of(study.task)[train]
    counts_as = window_counts(study.plan, label, names)
    shares = held_out.shares(study.task)[train]
    fitted = fit_calibration(shares, label, counts_as)
    return with_even_classes(fitted, label, counts_as)


def _file(
    study: Study, learner: Learner, calibration: Calibration, fold: Fold, folder: Path
) -> Path:
    """Export a learner for the two pads."""
    task = study.task
    classes = study.data.tasks[task].classes
    _, test = fold
    artifact = Artifact(
        spec_for(study.lifts, study.plan.groups),
        study.lifts.preparation,
        study.plan.decision.to_json(),
        [Head(TASK_HEADS[task], classes, learner, calibration)],
        study.features[test[:: max(1, len(test) // 20_000)]],
        {"data": study.data.name},
    )
    write_artifact(folder, artifact)
    path, _ = export_artifact(folder)
    return path


def _people_without(study: Study, train: IntArray) -> tuple[str, ...]:
    """The people of whom no window was trained on."""
    groups = np.unique(study.data.group_of(study.task)[train]).tolist()
    learned = {group.removeprefix(f"{LIFTS}/") for group in groups}
    return tuple(one for one in study.streams.people() if one not in learned)
