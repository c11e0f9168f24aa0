"""The timing-only baseline's input: how far the script of the protocol goes."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import FloatArray, IntArray
from holdfast.data.datasets.human_slip_uskin import CONTACT_N, contact_force_n
from holdfast.data.recording import DataSet, LabelledRows


def frames_since_contact(force_n: FloatArray, contact_n: float = CONTACT_N) -> IntArray:
    """[T] rows since z last rose through contact_n, -1 before: the timing of a scripted set."""
    touching = force_n >= contact_n
    touched_before = np.concatenate([[False], touching[:-1]])
    rises = touching & ~touched_before

    row = np.arange(len(force_n))
    last_rise = np.maximum.accumulate(np.where(rises, row, -1))
    return np.where(last_rise >= 0, row - last_rise, -1)


def clock_features(data: DataSet, rows: LabelledRows) -> FloatArray:
    """[M, 2]: frames since contact and normal force z in N, at each window.

    Contact: the last rise of z through 1 N; -1 before any. data: of all
    taxels, because z sums their normals.
    """
    features = np.empty((len(rows), 2))
    for trial in np.unique(rows.trial):
        here = rows.trial == trial
        force_n = contact_force_n(data.recordings[trial].samples)
        both = np.column_stack([frames_since_contact(force_n), force_n])
        features[here] = both[rows.row[here]]
    return features
