"""Check that the sealed file gives the table's labels: one fold is exported and streamed."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from holdfast.data.recording import DataSet
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.model import LABEL, Model
from holdfast.evaluation.model_outputs import (
    at_windows,
    everywhere,
    heads_with_task,
    steps_with,
    window_figures,
)
from holdfast.export.exporting import export_artifact
from holdfast.step.artifact import Artifact, write_artifact
from holdfast.step.heads import Head
from holdfast.step.network import IntArray
from holdfast.training.crossval import (
    FloatRows,
    HeldOut,
    fit_calibration,
    fit_learner,
    spec_for,
    splits_of,
)
from holdfast.training.plan import TASK_HEADS, TrainingPlan
from studies.real.figures import StreamedFold

FOLD = 0


def stream_one_fold(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    held_out: HeldOut,
    out: Path,
    seed: int,
) -> StreamedFold:
    """Export the first fold and stream its held-out people through the sealed file.

    Returns the file's figures on these people, and how many of its labels differ from the table's.
    """
    split = splits_of(data, plan, seed)[FOLD]
    train = {task: rows[0] for task, rows in split.items()}
    heads = [
        _head(data, features[task], plan, task, train[task], held_out, seed)
        for task in data.tasks
    ]
    rows = np.concatenate(
        [np.delete(features[task], train[task], axis=0) for task in data.tasks]
    )
    artifact = Artifact(
        spec_for(data, plan.groups),
        data.preparation,
        DecisionRules().to_json(),
        heads,
        rows,
        {"data": data.name},
    )
    write_artifact(out / "fold", artifact)
    path, verified = export_artifact(out / "fold")
    model = Model(path)
    held = split["situations"][1]
    part = data.of_groups(set(data.group_of("situations")[held].tolist()))
    outputs = ["unknown", *LABEL, *heads_with_task(model, part)]
    computed = everywhere(steps_with(model, outputs), part.recordings)
    windows = window_figures(model, part, computed, seed=seed)
    answers = at_windows(part, "situations", "situation", computed)
    expected = held_out.situations()[held]
    return StreamedFold(
        verified, windows, len(answers), int((answers != expected).sum())
    )


def _head(
    data: DataSet,
    features: FloatRows,
    plan: TrainingPlan,
    task: str,
    train: IntArray,
    held_out: HeldOut,
    seed: int,
) -> Head:
    forest = fit_learner(data, features, plan, task, train, seed)
    calibration = fit_calibration(
        held_out.shares(task)[train], data.tasks[task].label[train]
    )
    return Head(TASK_HEADS[task], data.tasks[task].classes, forest, calibration)
