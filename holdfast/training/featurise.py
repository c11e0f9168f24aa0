"""Features for training come from the step graph that runs on the hand.

A model's step on many recordings at once, on two threads.

Which recordings run together changes no bit of the outputs.

Rows that are computed once and kept in an .npy file, complete or not at all.
"""

from __future__ import annotations

import hashlib
import json
import time
from collections.abc import Callable, Sequence
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.graph import (
    Outputs,
    Steps,
    open_session,
    step_recordings,
    steps_of,
)
from holdfast.export.features import features_alone
from holdfast.export.heads import FloatRows
from holdfast.export.spec import StepSpec
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import DataSet, Recording

THREADS = 2
"""The step leaves the interpreter alone while it runs."""
FEWEST, MOST = 16, 32
"""Recordings a batch: a step of 5 costs little more than one of 2, and 32 states fit the cache."""
Rows = npt.NDArray[np.int64]


def stepped(
    steps: Steps,
    recordings: Sequence[Recording],
    rows: Sequence[Rows],
    part: Part = ignored,
) -> list[Outputs]:
    """Outputs [M, ..] of a step at the wanted rows [M] of every recording.

    part: called after every batch with the share of all samples that is done.
    """
    order = sorted(range(len(recordings)), key=lambda k: len(recordings[k].samples))
    size = min(MOST, max(FEWEST, -(-len(order) // THREADS)))
    batches = [order[start : start + size] for start in range(0, len(order), size)]

    def run(batch: list[int]) -> list[Outputs]:
        chosen = [recordings[k] for k in batch]
        values, valid = [one.samples for one in chosen], [one.valid for one in chosen]
        return step_recordings(steps, values, valid, [rows[k] for k in batch])

    found: list[Outputs] = [{} for _ in recordings]
    total, done = sum(len(one.samples) for one in recordings), 0
    with ThreadPoolExecutor(THREADS) as pool:
        for batch, outputs_of in zip(batches, pool.map(run, batches), strict=True):
            for k, one in zip(batch, outputs_of, strict=True):
                found[k] = one
            done += sum(len(recordings[k].samples) for k in batch)
            part(done / total)
    return found


def digest_of(settings: Any) -> str:
    """12 hex digits that name the settings of rows, for a file name; settings: JSON values."""
    return hashlib.sha256(json.dumps(settings, sort_keys=True).encode()).hexdigest()[
        :12
    ]


def kept_rows(path: Path, compute: Callable[[], FloatRows]) -> FloatRows:
    """[N, F] rows of a file, mapped into memory; computed and written first if it is not there.

    An interrupted run leaves no file of that name.
    """
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        half = path.with_suffix(".half.npy")
        np.save(half, compute())
        half.replace(path)
    rows: FloatRows = np.load(path, mmap_mode="r")
    return rows


def spec_for(data: DataSet, groups: tuple[str, ...]) -> StepSpec:
    """The step a set is trained and served with: its sensors, its median rate, its unit."""
    return StepSpec(
        n_sensors=data.n_sensors, rate_hz=data.rate_hz, unit=data.unit, groups=groups
    )


def features_of(
    data: DataSet, spec: StepSpec, part: Part = ignored
) -> dict[str, FloatRows]:
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
    data: DataSet,
    spec: StepSpec,
    rows: list[npt.NDArray[np.int64]],
    part: Part = ignored,
) -> list[FloatRows]:
    steps = steps_of(
        open_session(features_alone(spec).SerializeToString()), ["features"]
    )
    return [
        computed["features"] for computed in stepped(steps, data.recordings, rows, part)
    ]


def rows_wanted(data: DataSet) -> list[npt.NDArray[np.int64]]:
    """Per recording, the ascending rows at which any task has a window."""
    rows: list[list[npt.NDArray[np.int64]]] = [[] for _ in data.recordings]
    for labelled in data.tasks.values():
        for trial, row in _by_trial(labelled.trial, labelled.row):
            rows[trial].append(row)
    return [
        np.unique(np.concatenate(found)) if found else np.empty(0, np.int64)
        for found in rows
    ]


def _by_trial(
    trial: npt.NDArray[np.int64], row: npt.NDArray[np.int64]
) -> list[tuple[int, npt.NDArray[np.int64]]]:
    return [(int(index), row[trial == index]) for index in np.unique(trial)]


def pick_rows(
    data: DataSet,
    task: str,
    wanted: list[npt.NDArray[np.int64]],
    computed: list[FloatRows],
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
