"""Recordings -> features -> cross-validation -> calibrated learners -> an artifact for export."""

from __future__ import annotations

import hashlib
import platform
from dataclasses import dataclass, replace
from importlib.metadata import version
from pathlib import Path

import numpy as np

from holdfast.core.contract import SITUATIONS
from holdfast.core.errors import ClassMissing
from holdfast.core.reading import Json
from holdfast.export.artifact import Artifact, write_artifact
from holdfast.export.heads import Head
from holdfast.training.crossval import (
    HeldOut,
    cross_validate,
    fit_calibration,
    fit_learner,
    main_task,
    plan_for,
)
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.figures import HeadFigures
from holdfast.training.label_rule import fit_label_weights
from holdfast.training.metrics import report
from holdfast.training.plan import TASK_HEADS, TrainingPlan
from holdfast.training.progress import Part, Say, ignored
from holdfast.training.recording import DataSet, Recording

VERSIONS_OF = ("numpy", "scipy", "scikit-learn", "skl2onnx", "onnx", "onnxruntime")


@dataclass(frozen=True)
class Trained:
    """What a training run leaves in memory: held-out figures, and the votes behind them."""

    figures: HeadFigures
    held_out: HeldOut


def train(
    data: DataSet,
    out: str | Path,
    plan: TrainingPlan,
    *,
    seed: int = 0,
    say: Say = ignored,
    part: Part = ignored,
) -> Trained:
    """Train on a set and write the artifact folder.

    say: receives what begins. part: receives the share of it that is done.

    Raises ClassMissing, TooFewGroups, RateError or OutputError.
    """
    require_classes(data)
    plan = replace(plan, folds=min(plan.folds, max(2, len(data.groups()))))
    spec = spec_for(data, plan.groups)
    spec.warn_of_lost_bands()
    say(f"features of {len(data.recordings)} recordings")
    features = features_of(data, spec, part)
    held_out = cross_validate(data, features, plan, seed=seed, say=say)
    say("final learners on all recordings")
    figures = held_out_figures(data, held_out, seed)
    write_artifact(out, final_artifact(data, features, held_out, figures, plan, seed))
    return Trained(figures, held_out)


def final_artifact(
    data: DataSet,
    features: dict[str, FloatRows],
    held_out: HeldOut,
    figures: HeadFigures,
    plan: TrainingPlan,
    seed: int,
) -> Artifact:
    """Learners on all windows, calibrated on the held-out votes, with their origin.

    figures: of the held-out votes, for the model card.
    """
    for task, windows in data.tasks.items():
        plan = plan_for(data, features, plan, task, np.arange(len(windows)), seed)
    return Artifact(
        spec=spec_for(data, plan.groups),
        preparation=data.preparation,
        decision=plan.decision.to_json(),
        heads=[
            _final_head(data, features[task], plan, task, held_out, seed)
            for task in data.tasks
        ],
        rows=np.concatenate(list(features.values())),
        training=_origin(data, plan, seed, figures),
    )


def require_classes(data: DataSet) -> None:
    """Raise ClassMissing where a task has no window of a class that the set should have."""
    for task, rows in data.tasks.items():
        counts = np.bincount(rows.label, minlength=len(rows.classes))
        missing = [
            name
            for name, n in zip(rows.classes, counts, strict=True)
            if n == 0 and name not in data.lacks
        ]
        if missing:
            raise ClassMissing(
                f"task {task}: no window of {', '.join(missing)}",
                where=data.name,
                cause="recordings of that action are missing, or too few were chosen",
                next_step="add recordings, or choose more groups",
            )


def held_out_figures(data: DataSet, held_out: HeldOut, seed: int = 0) -> HeadFigures:
    """Metrics of the held-out votes, situations always four."""
    score = (
        held_out.shares("predict_250ms")[:, 1]
        if "predict_250ms" in data.tasks
        else None
    )
    return report(with_situations(data), held_out.situations(), score, seed=seed)


def with_situations(data: DataSet) -> DataSet:
    """The same set with a task "situations", made from the eight classes where it has none."""
    if "situations" in data.tasks:
        return data
    classes = data.tasks["classes"]
    situations = replace(classes, label=classes.label // 2, classes=SITUATIONS)
    return replace(data, tasks={**data.tasks, "situations": situations})


def fingerprint(recording: Recording) -> str:
    """First 12 digits of the SHA-256 of a recording's samples: says whether a model has seen it."""
    return hashlib.sha256(
        np.ascontiguousarray(recording.samples).tobytes()
    ).hexdigest()[:12]


def _final_head(
    data: DataSet,
    features: FloatRows,
    plan: TrainingPlan,
    task: str,
    held_out: HeldOut,
    seed: int,
) -> Head:
    rows = data.tasks[task]
    learner = fit_learner(data, features, plan, task, np.arange(len(rows)), seed)
    calibration, weights = fit_calibration(held_out.shares(task), rows.label), None
    if plan.inner_folds and task == main_task(data):
        votes = held_out.situation_votes()
        weights = fit_label_weights(
            votes, rows.label // (len(rows.classes) // len(SITUATIONS))
        )
    return Head(TASK_HEADS[task], rows.classes, learner, calibration, weights)


def _origin(data: DataSet, plan: TrainingPlan, seed: int, figures: HeadFigures) -> Json:
    """What the model card says of where it comes from."""
    prints = [fingerprint(recording) for recording in data.recordings]
    return {
        "data": data.name,
        "kind": data.kind,
        "redistributable": data.redistributable,
        "caveat": data.caveat,
        "data_sha256": hashlib.sha256("".join(sorted(prints)).encode()).hexdigest(),
        "recordings": prints,
        "groups": len(data.groups()),
        "group_kind": data.group_kind,
        "windows": {
            task: dict(
                zip(
                    rows.classes,
                    np.bincount(rows.label, minlength=len(rows.classes)).tolist(),
                    strict=True,
                )
            )
            for task, rows in data.tasks.items()
        },
        "main_task": main_task(data),
        "plan": plan.to_json(),
        "seed": seed,
        "held_out": figures.to_json(),
        "versions": versions(),
    }


def versions() -> dict[str, str]:
    """Versions of what computes the figures."""
    return {
        "python": platform.python_version(),
        **{name: version(name) for name in VERSIONS_OF},
    }
