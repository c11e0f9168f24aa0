"""One threshold on the amplitude of the field: the baseline on eflesh_slip, and its delay."""

from __future__ import annotations

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, BoolArray, FloatArray
from holdfast.training.datasets.eflesh_slip import LAST_SECOND, ThresholdAccuracy
from holdfast.training.recording import DataSet, Recording, grouped_folds

DEPARTURE_UT, DEPARTURE_ROWS = 100.0, 10
"""Distance from the baseline, uT, and for how many rows."""


def threshold_baseline(
    data: DataSet, *, n_folds: int | None = None, seed: int = 0
) -> ThresholdAccuracy:
    """Accuracy of one threshold on the amplitude of the field (norm over channels): a baseline.

    n_folds: None leaves out one block at a time, which needs no luck; with 6 folds the seed moves
    trial_accuracy between 0.971 and 0.993. Raises TooFewGroups.
    """
    field = [amplitude(recording.samples) for recording in data.recordings]
    largest = np.array([trial[LAST_SECOND].max() for trial in field])
    tugged = np.array([recording.action == "tug" for recording in data.recordings])
    blocks = np.array([recording.group for recording in data.recordings])

    n_folds = n_folds or len(data.groups())
    rows = data.tasks["situations"]

    at_window = np.empty(len(rows))
    for k, (trial, row) in enumerate(zip(rows.trial, rows.row, strict=True)):
        at_window[k] = field[trial][row]

    risky, groups = rows.label == RISKY_SLIP, data.group_of("situations")
    in_sample = float(np.mean((largest > fit_threshold(largest, tugged)) == tugged))
    return ThresholdAccuracy(
        trial_accuracy=_held_out_accuracy(largest, tugged, blocks, n_folds, seed),
        trial_accuracy_in_sample=in_sample,
        window_accuracy=_held_out_accuracy(at_window, risky, groups, n_folds, seed),
    )


def amplitude(samples: FloatArray) -> FloatArray:
    """[T, C] prepared -> [T] norm over all channels, in uT."""
    return np.sqrt(np.sum(samples**2, axis=1))


def fit_threshold(value: FloatArray, positive: BoolArray) -> float:
    """The cut of [M] values with most on the right side; of equal ones the widest gap's middle."""
    cuts = np.concatenate([[value.min() - 1.0], np.unique(value)])
    # Cut k calls the values up to cuts[k] negative, and the rest positive; the first calls all
    # values positive.
    order = np.searchsorted(cuts, value)
    gain = np.where(positive, -1.0, 1.0)
    right = np.cumsum(np.bincount(order, weights=gain, minlength=len(cuts)))

    gap = np.append(np.diff(cuts), 0.0)
    best = np.lexsort((gap, right))[-1]
    return float(cuts[best] + gap[best] / 2.0)


def departure_row(samples: FloatArray) -> int | None:
    """First row at which a channel leaves its baseline by over 100 uT for 0.1 s, or None.

    The set has no onset in it. This stands in for one, so that a delay can be measured from
    somewhere.
    """
    far = np.abs(samples).max(axis=1) > DEPARTURE_UT
    stays = np.lib.stride_tricks.sliding_window_view(far, DEPARTURE_ROWS).all(axis=1)
    return int(np.argmax(stays)) if stays.any() else None


def detection_delay_s(recording: Recording, alarm: BoolArray) -> float | None:
    """Seconds from the departure of the field to the first alarm [T]; below zero if it came before.

    None where the field never departs or no alarm comes.
    """
    departed = departure_row(recording.samples)
    if departed is None or not alarm.any():
        return None
    return float((int(np.argmax(alarm)) - departed) / recording.rate_hz)


def _held_out_accuracy(
    value: FloatArray,
    positive: BoolArray,
    blocks: npt.ArrayLike,
    n_folds: int,
    seed: int,
) -> float:
    """Share of values [M] on the right side of a threshold that other blocks chose."""
    right = 0
    for train, test in grouped_folds(blocks, n_folds, seed=seed):
        threshold = fit_threshold(value[train], positive[train])
        right += int(np.sum((value[test] > threshold) == positive[test]))
    return right / len(value)
