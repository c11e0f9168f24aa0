"""The reference for what an exported file makes of votes: labels, probabilities, flags."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, BoolArray, FloatArray
from holdfast.export.forest import IntArray
from holdfast.export.heads import MAIN_HEAD, Head
from holdfast.export.spec import RANGE_LIMIT, StepSpec

FloatRows = npt.NDArray[np.float32]


def riskier_argmax(votes: npt.NDArray[Any]) -> IntArray:
    """[N, K] votes -> [N] label: the largest; among equal ones the riskier (the last)."""
    k = votes.shape[1]
    return np.asarray(k - 1 - np.argmax(votes[:, ::-1], axis=1), dtype=np.int64)


def reference_label(head: Head, votes: IntArray) -> IntArray:
    """[N, K] votes -> [N] label of a head; of the main one, a situation by its label weights."""
    if head.name != MAIN_HEAD:
        return riskier_argmax(votes)
    return riskier_argmax(weighted(situation_votes(votes), head.label_weights))


def weighted(votes: IntArray, weights: tuple[float, ...] | None) -> npt.NDArray[Any]:
    """Votes [N, 4] times the weights of their situations, in float32 as in the file."""
    if weights is None:
        return votes
    return np.asarray(votes.astype(np.float32) * np.asarray(weights, dtype=np.float32))


def reference_probability(head: Head, votes: IntArray) -> npt.NDArray[np.float64]:
    """Calibrated probabilities [N, K] of exact votes [N, K], in float64."""
    shares = votes / votes.sum(axis=1, keepdims=True)
    logits = shares @ head.calibration.weights + head.calibration.bias
    raised = np.exp(logits - logits.max(axis=1, keepdims=True))
    return np.asarray(raised / raised.sum(axis=1, keepdims=True), dtype=np.float64)


def reference_heavy(votes: IntArray) -> npt.NDArray[np.bool_]:
    """[N, 8] votes -> [N]: at least as many for heavy as for light; "nothing" does not count."""
    contact = votes[:, 2:]
    return np.asarray(
        contact[:, 1::2].sum(axis=1) >= contact[:, 0::2].sum(axis=1), dtype=np.bool_
    )


def situation_votes(votes: IntArray) -> IntArray:
    """Votes for the four situations; of eight classes, light and heavy are added up."""
    return (
        votes
        if votes.shape[1] == len(SITUATIONS)
        else votes.reshape(len(votes), -1, 2).sum(axis=2)
    )


def reference_flags(
    values: FloatArray, valid: BoolArray, spec: StepSpec
) -> dict[str, npt.NDArray[Any]]:
    """settled, unknown and usable_sensors [T] by the guard's rule in plain Python, from fresh."""
    delivered, lost = np.zeros(spec.n_sensors, int), np.zeros(spec.n_sensors, int)
    flags: dict[str, list[Any]] = {"settled": [], "unknown": [], "usable_sensors": []}
    for row, delivers in zip(values.reshape(len(values), -1, 3), valid, strict=True):
        good = (
            delivers
            & np.isfinite(row).all(axis=1)
            & (np.abs(row) < RANGE_LIMIT[spec.unit]).all(axis=1)
        )
        lost = np.where(good, 0, lost + 1)
        delivered = np.where(
            good, delivered + 1, np.where(lost > spec.gap_samples, 0, delivered)
        )
        settled = delivered >= spec.settle_samples
        usable = int((good & settled).sum())
        flags["settled"].append(int(settled.sum()) >= spec.min_valid_sensors)
        flags["unknown"].append(usable < spec.min_valid_sensors)
        flags["usable_sensors"].append(usable)
    return {name: np.array(column) for name, column in flags.items()}
