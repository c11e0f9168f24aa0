"""Recordings, their labelled windows, and a data set of both: what every reader returns."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import BoolArray, FloatArray, IntArray, Unit
from holdfast.core.reading import Json
from holdfast.edge_runtime.preparation import Preparation
from holdfast.training.timeline import Phase, RiskyEvent

StringArray = npt.NDArray[np.str_]


@dataclass(frozen=True)
class Recording:
    """One trial, as it was recorded, unit and rate known.

    trial_id: unique in its set. group: the person (or block, object, trial) that must not be split.
    samples: [T, C] float64, *prepared* (bias removed, magnets turned the right way round).
    valid: [T, C/3]. rate_hz: from the time stamps where there are any.
    object_name, action: None where the set has no such notion. phases: what happens when, in rows;
    those in no phase have no label. events: grips that fail. person: None where none is named.
    """

    trial_id: str
    group: str
    samples: FloatArray
    valid: BoolArray
    rate_hz: float
    unit: Unit
    object_name: str | None = None
    action: str | None = None
    phases: tuple[Phase, ...] = ()
    events: tuple[RiskyEvent, ...] = ()
    person: str | None = None

    @property
    def n_sensors(self) -> int:
        """Number of 3-axis sensors."""
        return self.samples.shape[1] // 3


def finite_sensors(raw: FloatArray) -> BoolArray:
    """[T, C] -> [T, C/3]: True where all three channels of a sensor are finite."""
    by_sensor = np.isfinite(raw).reshape(len(raw), -1, 3)
    return np.logical_and.reduce(by_sensor, axis=2)


@dataclass(frozen=True)
class LabelledRows:
    """Windows of one task: the last row of each, and its label.

    trial: [M] index into the set's recordings. row: [M] last row of the window. label: [M].
    classes: name of each label value (label k means classes[k]).
    """

    trial: IntArray
    row: IntArray
    label: IntArray
    classes: tuple[str, ...]

    def __len__(self) -> int:
        return len(self.label)

    def class_counts(self) -> dict[str, int]:
        """Windows of each class, by name, zeros included."""
        counts = np.bincount(self.label, minlength=len(self.classes))
        return dict(zip(self.classes, counts.tolist(), strict=True))

    def take(self, keep: npt.NDArray[Any]) -> LabelledRows:
        """The same task on a subset of the windows (boolean mask or indices)."""
        return LabelledRows(
            self.trial[keep], self.row[keep], self.label[keep], self.classes
        )

    @staticmethod
    def concatenated(parts: Sequence[LabelledRows]) -> LabelledRows:
        """The windows of all parts, one after the other, with the classes of the first."""
        trials, rows, labels = [], [], []
        for part in parts:
            trials.append(part.trial)
            rows.append(part.row)
            labels.append(part.label)
        return LabelledRows(
            trial=np.concatenate(trials),
            row=np.concatenate(rows).astype(np.int64),
            label=np.concatenate(labels).astype(np.int64),
            classes=parts[0].classes,
        )

    def of_trials(self, index: list[int]) -> LabelledRows:
        """The windows of the recordings at these ascending places, numbered anew."""
        kept = self.take(np.isin(self.trial, index))
        return replace(kept, trial=np.searchsorted(index, kept.trial).astype(np.int64))


@dataclass(frozen=True)
class DataSet:
    """Recordings and the tasks that can be learned from them.

    tasks: "situations" (labels 0..3) or "classes" (labels 0..7), and further heads such as
    "predict_250ms" (labels 0/1). rate_hz: the median over the recordings.
    redistributable: False for sets without a licence; what is made from them stays in build/.
    caveat: the sentence that must stand with every number from this set.
    lacks: situations the set does not have by its nature; any other absent class is an error.
    group_kind: what a group is: person, object, trial or block.
    """

    name: str
    recordings: list[Recording]
    tasks: dict[str, LabelledRows]
    rate_hz: float
    unit: Unit
    preparation: Preparation
    kind: str
    redistributable: bool
    caveat: str
    notes: Json = field(default_factory=dict)
    lacks: tuple[str, ...] = ()
    group_kind: str = "trial"

    @property
    def n_sensors(self) -> int:
        """Number of 3-axis sensors."""
        return self.recordings[0].n_sensors

    def groups(self) -> list[str]:
        """The distinct groups (people, blocks), sorted."""
        return sorted({recording.group for recording in self.recordings})

    def group_of(self, task: str) -> StringArray:
        """[M] group of every window of a task."""
        names = np.array([recording.group for recording in self.recordings])
        return names[self.tasks[task].trial]

    def of_groups(self, names: Collection[str]) -> DataSet:
        """The part of the set that these people (or blocks) recorded; the set's rate stays."""
        index, kept = [], []
        for k, recording in enumerate(self.recordings):
            if recording.group in names:
                index.append(k)
                kept.append(recording)
        tasks = {task: rows.of_trials(index) for task, rows in self.tasks.items()}
        return replace(self, recordings=kept, tasks=tasks)
