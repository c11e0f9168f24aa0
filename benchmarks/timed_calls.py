"""What is timed of a model: its learner on one row, its whole step on one sample, files beside each
other."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from itertools import cycle
from pathlib import Path

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray, Json
from holdfast.edge_runtime.graph import StepGraph, open_session
from holdfast.live.bench import (
    busy_wait,
    time_in_turns,
)
from holdfast.simulation.folder import write_set
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from holdfast.training.datasets import load
from holdfast.training.featurise import FloatRows
from holdfast.training.recording import DataSet

FLOOR = "busy-wait reference"
"""A busy wait as long as the first call: its own spread is the machine's."""
TRIALS = 400
"""Simulated, to train the forest of the thesis on."""


def simulated_set(work: Path, rate_hz: float) -> DataSet:
    """A small simulated set at the model's rate."""
    scene = Scene(read_scene_file("thesis", rate_hz=rate_hz), 0)
    write_set(scene, work / "set", TRIALS)
    return load(work / "set", windows="thesis")


def learner_call(model: bytes, rows: FloatRows) -> Callable[[], object]:
    """Answers one of the rows [N, F] a call, in turn. model: a file cut at its features."""
    session = open_session(model)
    one = [rows[k : k + 1] for k in range(len(rows))]
    turn = cycle(range(len(rows)))
    return lambda: session.run(["votes"], {"features": one[next(turn)]})


def step_call(
    model: bytes, samples: FloatArray, valid: BoolArray | None = None
) -> Callable[[], object]:
    """Steps over one of the samples [T, C] a call, in turn. valid [S]: sensors; None for all."""
    graph = StepGraph(open_session(model))
    turn = cycle(range(len(samples)))
    graph.valid[:] = True if valid is None else valid

    def step() -> None:
        graph.sample[0] = samples[next(turn)]
        graph.step()

    return step


def times_beside(
    calls: Mapping[str, Callable[[], object]], turns: int, calls_a_turn: int
) -> dict[str, Json]:
    """us of a call, all in one run with FLOOR: median, 99 %, and over the median of the first."""
    first = next(iter(calls))
    warm = time_in_turns({first: calls[first]}, 1, calls_a_turn)
    floor = busy_wait(float(np.median(warm[first])))

    times_us = time_in_turns({**calls, FLOOR: floor}, turns, calls_a_turn)
    first_us = float(np.median(times_us[first]))
    found = {}
    for name, values in times_us.items():
        p50, p99 = np.percentile(values, (50, 99)).tolist()
        found[name] = {"step_us": p50, "p99_us": p99, "over_first": p50 / first_us}
    return found
