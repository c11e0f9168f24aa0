"""CPU seconds of features and of training against the number of trials."""

from __future__ import annotations

import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.crossval import cross_validate, fit_learner
from holdfast.training.datasets import load
from holdfast.training.featurise import features_of, spec_for
from holdfast.training.plan import TrainingPlan

TRIALS = (50, 100, 200, 400)


@dataclass(frozen=True)
class TrainingCost:
    """CPU seconds of each stage from so many trials."""

    trials: int
    windows: int
    samples: int
    simulated_cpu_s: float
    read_and_labelled_cpu_s: float
    features_cpu_s: float
    forest_cpu_s: float
    cross_validated_6_folds_cpu_s: float


def training_times() -> list[TrainingCost]:
    """One row a number of trials of `thesis` at 150 Hz."""
    with tempfile.TemporaryDirectory() as work:
        return [_row(Path(work) / str(trials), trials) for trials in TRIALS]


def _row(place: Path, trials: int) -> TrainingCost:
    plan = TrainingPlan(folds=6)
    simulated_s = _cpu_s(
        lambda: write_set(Scene(read_scene_file("thesis"), 0), place, trials)
    )[1]
    data, read_s = _cpu_s(lambda: load(place, windows="thesis"))
    features, features_s = _cpu_s(
        lambda: features_of(data, spec_for(data, plan.groups))
    )
    task = data.tasks["classes"]
    _, fit_s = _cpu_s(
        lambda: fit_learner(
            data, features["classes"], plan, "classes", np.arange(len(task)), 0
        )
    )
    _, validated_s = _cpu_s(lambda: cross_validate(data, features, plan))
    return TrainingCost(
        trials=trials,
        windows=len(task),
        samples=sum(len(one.samples) for one in data.recordings),
        simulated_cpu_s=simulated_s,
        read_and_labelled_cpu_s=read_s,
        features_cpu_s=features_s,
        forest_cpu_s=fit_s,
        cross_validated_6_folds_cpu_s=validated_s,
    )


def _cpu_s(call: Callable[[], Any]) -> tuple[Any, float]:
    started = time.process_time()
    made = call()
    return made, time.process_time() - started
