"""Sets of the study, with their features at every sample on disk, as these exceed the memory."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NORMAL_AXIS, NOTHING
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.states import labels_everywhere
from holdfast.evaluation.trials import LabelledTrial, grasps_of, without_samples
from holdfast.export.network import IntArray
from holdfast.training.datasets import load
from holdfast.training.featurise import (
    FloatRows,
    digest_of,
    features_everywhere,
    kept_rows,
    spec_for,
)
from holdfast.training.plan import CLOCK_FREE_GROUPS, RAW_GROUPS
from holdfast.training.recording import DataSet, Recording
from holdfast.training.windows import Choice
from studies.fast_handover.ideas import Features

CHOOSE = "choose"
STYLES = ("author", "p1", "p2")
EVALUATED = (*STYLES, "asked-holds")
"""Sets by their folders: for the threshold, of a style each, and all that are evaluated."""
CONTEXT_S = (0.5, 1.0, 2.0)


@dataclass(frozen=True)
class Labelled:
    """Windows to train on. label: [M], 0..7. held_object: [M], its name, "" without one."""

    features: FloatRows
    label: IntArray
    held_object: npt.NDArray[np.str_]


@dataclass(frozen=True)
class Streams:
    """A set that is evaluated.

    trials: without their samples. features [sum of T, F] and truth [sum of T]: of all trials, one
    after the other. row [M]: the set's windows among those rows. They are scored by the truth of
    the moment, because their labels widen each slip by 0.10 s (training/windows.py), which no
    detector of the moment can know.
    """

    trials: list[LabelledTrial]
    features: FloatRows
    lengths: list[int]
    truth: IntArray
    row: IntArray

    @property
    def label(self) -> IntArray:
        """[M] situation of each window."""
        return self.truth[self.row]


@cache
def labelled(folder: Path, windows: Choice, features: Features) -> Labelled:
    """A set to train on."""
    data = load(folder, windows=windows)
    task = data.tasks["classes"]
    rows = everywhere(folder, data, features)
    names = np.array([one.object_name or "" for one in data.recordings])
    return Labelled(np.asarray(rows[_rows(data)]), task.label, names[task.trial])


@cache
def streams(folder: Path, windows: Choice, features: Features) -> Streams:
    """A set to evaluate on."""
    data = load(folder, windows=windows)
    recordings = [without_samples(one) for one in data.recordings]
    trials = [
        LabelledTrial(one, grasps)
        for one, grasps in zip(recordings, grasps_of(folder, recordings), strict=True)
    ]
    lengths = [len(one.samples) for one in data.recordings]
    truth = np.concatenate(
        [_situations(one, n) for one, n in zip(recordings, lengths, strict=True)]
    )
    return Streams(
        trials, everywhere(folder, data, features), lengths, truth, _rows(data)
    )


def everywhere(folder: Path, data: DataSet, features: Features) -> FloatRows:
    """[sum of T, F] features at every sample, recording after recording, computed once."""
    spec = spec_for(data, RAW_GROUPS if features == "raw window" else CLOCK_FREE_GROUPS)
    path = folder / f"features-{digest_of([spec.to_json(), len(data.recordings)])}.npy"
    rows = kept_rows(path, lambda: np.concatenate(features_everywhere(data, spec)))
    if features != "with context":
        return rows
    contexts = np.concatenate([context(one) for one in data.recordings])
    return np.hstack([rows, contexts])


def context(recording: Recording) -> FloatRows:
    """[T, 3]: mean normal force over the last CONTEXT_S seconds, N; shorter at a trial's start."""
    normal = recording.samples[:, NORMAL_AXIS::3].sum(axis=1)
    summed = np.concatenate([[0.0], np.cumsum(normal)])
    now = np.arange(1, len(normal) + 1)
    first = [
        np.maximum(now - round(seconds * recording.rate_hz), 0) for seconds in CONTEXT_S
    ]
    return np.column_stack(
        [(summed[now] - summed[since]) / (now - since) for since in first]
    ).astype(np.float32)


def training_part(
    folder: Path,
    names: Sequence[str],
    windows: Choice = "balanced",
    features: Features = "default",
) -> Labelled:
    """Several sets of a folder to train on as one."""
    parts = [labelled(folder / name, windows, features) for name in names]
    return Labelled(
        np.concatenate([one.features for one in parts]),
        np.concatenate([one.label for one in parts]),
        np.concatenate([one.held_object for one in parts]),
    )


def without(part: Labelled, name: str) -> Labelled:
    """All but the windows of an object."""
    kept = part.held_object != name
    return Labelled(part.features[kept], part.label[kept], part.held_object[kept])


def _situations(recording: Recording, n: int) -> IntArray:
    """[T] the situation at each sample; nothing where there is no label."""
    truth = labels_everywhere(recording.phases, n)
    return np.where(truth == UNKNOWN, NOTHING, truth)


def _rows(data: DataSet) -> IntArray:
    """[M] where each window's last row stands among all samples of the set."""
    starts = np.concatenate(
        [[0], np.cumsum([len(one.samples) for one in data.recordings])[:-1]]
    )
    task = data.tasks["classes"]
    rows: IntArray = starts[task.trial] + task.row
    return rows
