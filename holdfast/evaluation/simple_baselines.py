"""Baselines on the windows of scenes: the raw window alone, timing only, a shear-rate threshold."""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.core.contract import NORMAL_AXIS, BoolArray, FloatArray
from holdfast.core.trial_layout import NORMAL_FLOOR
from holdfast.export.spec import window_samples
from holdfast.training.datasets.human_slip_labels import (
    contact_force_n,
    frames_since_contact,
)
from holdfast.training.featurise import FloatRows, features_of, spec_for
from holdfast.training.plan import RAW_GROUPS
from holdfast.training.recording import DataSet, LabelledRows, Recording

BACK_SAMPLES, JUMP_N = 2, 0.5
SHEAR_RATE_LAW = (
    "a slip where |S[t] - S[t-2]| > 0.5 N, S the sum over the fingers of |x| + |y|"
)


def raw_windows(data: DataSet) -> FloatRows:
    """[M, N C] the window group's features of every window of "classes", each from a fresh state.

    Every window is stepped through the graph as a recording of its own, so nothing before its first
    row is seen: of the trial only the offset remains, which the preparation takes from its unloaded
    start. The group has no bias or filter of its own: without a lost sample it equals the streamed
    one.
    """
    alone = windows_alone(data)
    return features_of(alone, spec_for(alone, RAW_GROUPS))["classes"]


def windows_alone(data: DataSet) -> DataSet:
    """The windows of "classes", each a recording of the N samples that end at its row."""
    task, n = data.tasks["classes"], window_samples(data.rate_hz)
    recordings = [
        _cut(data.recordings[trial], row + 1 - n, row + 1)
        for trial, row in zip(task.trial, task.row, strict=True)
    ]
    last = np.array(
        [len(recording.samples) - 1 for recording in recordings], dtype=np.int64
    )
    rows = LabelledRows(np.arange(len(task)), last, task.label, task.classes)
    return replace(data, recordings=recordings, tasks={"classes": rows})


def _cut(recording: Recording, first: int, stop: int) -> Recording:
    rows = slice(max(0, first), stop)
    return replace(
        recording, samples=recording.samples[rows], valid=recording.valid[rows]
    )


def clock_features(data: DataSet) -> FloatRows:
    """[M, 2]: s since contact (below 0 before any) and summed normal force in N.

    The timing-only baseline shows how far the script alone goes; it is never an input.
    """
    task = data.tasks["classes"]
    features = np.empty((len(task), 2), dtype=np.float32)
    for trial in np.unique(task.trial):
        here, force_n = (
            task.trial == trial,
            contact_force_n(data.recordings[trial].samples),
        )
        since_s = frames_since_contact(force_n, NORMAL_FLOOR["N"]) / data.rate_hz
        features[here] = np.column_stack([since_s, force_n])[task.row[here]]
    return features


def shear_rate_fires(samples: FloatArray) -> BoolArray:
    """[T, C] in N -> [T]: the summed shear changed by more than 0.5 N within two samples. Causal.

    Two samples are 40 ms at 50 Hz and 13 ms at 150 Hz, so the law depends on the rate.
    """
    fires: BoolArray = shear_change(samples) > JUMP_N
    return fires


def shear_change(samples: FloatArray) -> FloatArray:
    """[T, C] -> [T] change of the summed shear within two samples; 0 at the start."""
    shear = np.abs(samples.reshape(len(samples), -1, 3)[..., :NORMAL_AXIS]).sum(
        axis=(1, 2)
    )
    jump = np.zeros(len(samples))
    jump[BACK_SAMPLES:] = np.abs(shear[BACK_SAMPLES:] - shear[:-BACK_SAMPLES])
    return jump


def shear_rate_at(data: DataSet, reach_samples: int = 1) -> BoolArray:
    """[M] whether it fires at any of the last `reach_samples` samples of each window."""
    task = data.tasks["classes"]
    fired = np.zeros(len(task), dtype=np.bool_)
    for trial in np.unique(task.trial):
        here = task.trial == trial
        fires = np.cumsum(
            np.concatenate([[0], shear_rate_fires(data.recordings[trial].samples)])
        )
        row = task.row[here] + 1
        fired[here] = fires[row] > fires[np.maximum(row - reach_samples, 0)]
    return fired
