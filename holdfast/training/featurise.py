"""Features for training, from the step graph that runs on the hand.

Recordings are stepped in batches on two threads; which of them run together changes no bit of the
outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from holdfast.core.contract import IntArray
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
FEWEST, MOST = 16, 32
"""Recordings a batch: a step of 5 costs little more than one of 2, and 32 states fit the cache."""


def stepped(
    steps: Steps,
    recordings: Sequence[Recording],
    rows: Sequence[IntArray],
    part: Part = ignored,
) -> list[Outputs]:
    """Outputs [M, ..] of a step at the wanted rows [M] of every recording.

    part: called after every batch with the share of all samples that is done.
    """
    lengths = np.array([len(recording.samples) for recording in recordings])
    # Recordings of like length together: a batch is padded to its longest.
    order = np.argsort(lengths, kind="stable").tolist()
    # Half of them for each thread, as far as the limits of a batch allow.
    share = -(-len(order) // THREADS)
    size = min(MOST, max(FEWEST, share))
    batches = [order[start : start + size] for start in range(0, len(order), size)]

    def run(batch: list[int]) -> list[Outputs]:
        values = [recordings[k].samples for k in batch]
        valid = [recordings[k].valid for k in batch]
        wanted = [rows[k] for k in batch]
        return step_recordings(steps, values, valid, wanted)

    outputs: list[Outputs] = [{} for _ in recordings]
    all_samples = int(lengths.sum())
    done = 0
    # Threads and no processes: the step leaves the interpreter alone while it runs.
    with ThreadPoolExecutor(THREADS) as pool:
        for batch, of_batch in zip(batches, pool.map(run, batches), strict=True):
            for k, output in zip(batch, of_batch, strict=True):
                outputs[k] = output
            done += int(lengths[batch].sum())
            part(done / all_samples)
    return outputs


def spec_for(data: DataSet, groups: tuple[str, ...]) -> StepSpec:
    """The step a set is trained and served with: its sensors, its median rate, its unit."""
    # Where the newtons are not verified, a threshold in N may lie inside a firm grip.
    force_decides = None if data.forces_verified else False
    return StepSpec(
        n_sensors=data.n_sensors,
        rate_hz=data.rate_hz,
        unit=data.unit,
        groups=groups,
        hand=data.hand,
        force_decides=force_decides,
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
    every = [np.arange(len(recording.samples)) for recording in data.recordings]
    return _compute(data, spec, every)


def _compute(
    data: DataSet, spec: StepSpec, rows: list[IntArray], part: Part = ignored
) -> list[FloatRows]:
    """Features at these rows of each recording, by the graph without its learners."""
    # The graph that runs on the hand, so that a model is trained on what it will be given there.
    session = open_session(features_alone(spec).SerializeToString())
    steps = steps_of(session, ["features"])
    # The other outputs of a step are its state, which training does not need.
    outputs = stepped(steps, data.recordings, rows, part)
    return [output["features"] for output in outputs]


def rows_wanted(data: DataSet) -> list[IntArray]:
    """Per recording, the ascending rows at which any task has a window."""
    wanted = [np.empty(0, np.int64) for _ in data.recordings]
    for windows in data.tasks.values():
        for trial in np.unique(windows.trial).tolist():
            # Windows of several tasks often end at the same row, which is computed once for all of
            # them.
            rows = windows.row[windows.trial == trial]
            wanted[trial] = np.union1d(wanted[trial], rows)
    return wanted


def pick_rows(
    data: DataSet, task: str, wanted: list[IntArray], computed: list[FloatRows]
) -> FloatRows:
    """The task's windows in their order, out of what was computed per recording."""
    windows = data.tasks[task]
    first = computed[0]

    picked = np.empty((len(windows), *first.shape[1:]), dtype=first.dtype)
    for trial in np.unique(windows.trial).tolist():
        here = windows.trial == trial
        # The wanted rows ascend and hold every row of a window, so the search is exact.
        places = np.searchsorted(wanted[trial], windows.row[here])
        picked[here] = computed[trial][places]
    return picked
