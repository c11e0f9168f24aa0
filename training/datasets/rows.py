"""The last step of every reader: the windows of single trials become one task."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.edge_runtime.contract import BoolArray, FloatArray
from holdfast.training.recording import LabelledRows

TrialRows = tuple[npt.NDArray[Any], npt.NDArray[Any]]
"""Last rows [m] of a trial's windows, and their labels [m]."""


def join_trials(parts: Sequence[TrialRows], classes: tuple[str, ...]) -> LabelledRows:
    """One task from the windows of all trials, part k belonging to recording k."""
    trial = np.repeat(np.arange(len(parts)), [len(rows) for rows, _ in parts])
    row, label = (np.concatenate([part[k] for part in parts]).astype(np.int64) for k in (0, 1))
    return LabelledRows(trial.astype(np.int64), row, label, classes)


def finite_sensors(raw: FloatArray) -> BoolArray:
    """[T, C] -> [T, C/3]: True where all three channels of a sensor are finite."""
    by_sensor = np.isfinite(raw).reshape(len(raw), -1, 3)
    return np.logical_and.reduce(by_sensor, axis=2)
