"""A model's step on many recordings at once, on two threads.

Which recordings run together changes no bit of the outputs.
"""

from __future__ import annotations

from collections.abc import Sequence
from concurrent.futures import ThreadPoolExecutor

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.graph import Outputs, step_recordings
from holdfast.edge_runtime.stepper import Steps
from holdfast.training.recording import Recording
from holdfast.training.say import Part, ignored

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
