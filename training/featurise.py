"""Features for training come from the step graph that runs on the hand."""

from __future__ import annotations

import time
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.graph import open_session, steps_of
from holdfast.export.spec import StepSpec
from holdfast.export.step_graph import features_alone
from holdfast.training.recording import DataSet
from holdfast.training.say import Part, ignored
from holdfast.training.stepping import stepped

FloatRows = npt.NDArray[np.float32]


def spec_for(data: DataSet, groups: tuple[str, ...]) -> StepSpec:
    """The step a set is trained and served with: its sensors, its median rate, its unit."""
    return StepSpec(n_sensors=data.n_sensors, rate_hz=data.rate_hz, unit=data.unit, groups=groups)


def features_of(data: DataSet, spec: StepSpec, part: Part = ignored) -> dict[str, FloatRows]:
    """Task -> features [M, F] float32 at the last row of every window; one pass for all tasks."""
    wanted = rows_wanted(data)
    computed = _compute(data, spec, wanted, part)
    return {task: pick_rows(data, task, wanted, computed) for task in data.tasks}


def features_everywhere(data: DataSet, spec: StepSpec) -> list[FloatRows]:
    """Features [T, F] at every sample of every recording, as a free-running stream has them."""
    return _compute(
        data, spec, [np.arange(len(recording.samples)) for recording in data.recordings]
    )


@dataclass(frozen=True)
class FeatureCost:
    """CPU time of the features of all samples of a set, stepped in batches."""

    cpu_s: float
    samples: int
    us_per_sample: float


def cpu_cost(data: DataSet, spec: StepSpec) -> FeatureCost:
    """CPU time of stepping all features over every sample of a set."""
    last = [np.array([len(recording.samples) - 1]) for recording in data.recordings]
    started = time.process_time()
    _compute(data, spec, last)
    cpu_s = time.process_time() - started
    samples = sum(len(recording.samples) for recording in data.recordings)
    return FeatureCost(cpu_s, samples, 1e6 * cpu_s / samples)


def _compute(
    data: DataSet, spec: StepSpec, rows: list[npt.NDArray[np.int64]], part: Part = ignored
) -> list[FloatRows]:
    steps = steps_of(open_session(features_alone(spec).SerializeToString()), ["features"])
    return [computed["features"] for computed in stepped(steps, data.recordings, rows, part)]


def rows_wanted(data: DataSet) -> list[npt.NDArray[np.int64]]:
    """Per recording, the ascending rows at which any task has a window."""
    rows: list[list[npt.NDArray[np.int64]]] = [[] for _ in data.recordings]
    for labelled in data.tasks.values():
        for trial, row in _by_trial(labelled.trial, labelled.row):
            rows[trial].append(row)
    return [np.unique(np.concatenate(found)) if found else np.empty(0, np.int64) for found in rows]


def _by_trial(
    trial: npt.NDArray[np.int64], row: npt.NDArray[np.int64]
) -> list[tuple[int, npt.NDArray[np.int64]]]:
    return [(int(index), row[trial == index]) for index in np.unique(trial)]


def pick_rows(
    data: DataSet, task: str, wanted: list[npt.NDArray[np.int64]], computed: list[FloatRows]
) -> FloatRows:
    """The task's windows in its own order, out of what was computed per recording."""
    labelled = data.tasks[task]
    starts = np.concatenate([[0], np.cumsum([len(rows) for rows in wanted])])
    place = np.empty(len(labelled), dtype=np.int64)
    for trial in np.unique(labelled.trial):
        here = labelled.trial == trial
        place[here] = starts[trial] + np.searchsorted(wanted[trial], labelled.row[here])
    picked: npt.NDArray[Any] = np.concatenate(computed)[place]
    return picked
