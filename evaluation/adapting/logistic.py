"""The logistic rule of a correction, fitted on a person's samples beside those of other slips.

A slip must be called once, while a hand-over must not be called at any of its samples. So after a
first fit only the TOP best samples of each slip count, and the rule is fitted again on these, some
times. All samples that are no slip count throughout (multiple-instance learning: Andrews,
Tsochantaridis, Hofmann, NIPS 2002).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import numpy.typing as npt
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression

from holdfast.edge_runtime.contract import FloatArray
from holdfast.edge_runtime.onnx_network import INPUT_MOST
from holdfast.evaluation.adapting.evidence import Stream, is_slip
from holdfast.export.correction import Correction, rows_of
from holdfast.export.forest import EXACT_FLOAT32
from holdfast.export.network import LOGIT_STEPS, WEIGHT_MOST, Float32Array, Inputs, Layer, Network

TOP, ROUNDS = 3, 4
OF_PERSON = 0.9
"""Share of the weight of all samples that are no slip, for those of the person."""
SCALE = 2000.0
"""Sum of the weights of slips, and of the others; with INVERSE_PENALTY it says how small the
correction stays."""
INVERSE_PENALTY = 0.03
MOST_STEPS = 100
"""Of a fit: held-out trials judge the rule, so its last digits do not matter."""
LEAST_KNEE = 1e-6
MOST_NATS = 10.0
"""How far `moved` may move a logit, and still add exactly."""


@dataclass(frozen=True)
class Rows:
    """Candidate rows. x [N, I]: inputs of a correction. weight [N]. slip [N]: its number, or -1."""

    x: Float32Array
    weight: FloatArray
    slip: npt.NDArray[np.int64]


def fit_correction(
    person: Sequence[Stream], others: Sequence[Stream], votes_in_all: int
) -> Correction:
    """The correction for a person. others: recordings with slips, of any person."""
    x = _rows_of(others)
    inputs = _inputs(x, votes_in_all, others[0].votes.shape[1])
    rows = _weighed(person, others, inputs)
    weights, bias = _fitted(rows)
    return _in_whole_numbers(inputs, weights, bias)


def _rows_of(streams: Sequence[Stream]) -> Float32Array:
    return np.concatenate([rows_of(one.features, one.votes) for one in streams])


def _inputs(x: Float32Array, votes_in_all: int, n_classes: int) -> Inputs:
    """A knee at each input's median magnitude; of votes, at all votes."""
    knee = np.median(np.abs(x), axis=0) + LEAST_KNEE
    knee[-n_classes:] = votes_in_all
    most = np.full(x.shape[1], INPUT_MOST, dtype=np.float32)
    return Inputs(knee.astype(np.float32), most, np.zeros_like(most))


def _weighed(person: Sequence[Stream], others: Sequence[Stream], inputs: Inputs) -> Rows:
    """All rows: slips weigh as much as the rest, and the person's most of the rest."""
    streams, ends, slip, count = [*person, *others], [], [], 0
    for one in streams:
        slip.append(np.where(is_slip(one.event), one.event + count, -1))
        count += len(one.recording.events)
        ends.append(len(one.row))
    number = np.concatenate(slip)
    of_person = np.arange(len(number)) < sum(ends[: len(person)])
    weight = np.zeros(len(number))
    for mask, share in (
        (number >= 0, 1.0),
        ((number < 0) & of_person, OF_PERSON),
        ((number < 0) & ~of_person, 1.0 - OF_PERSON),
    ):
        weight[mask] = SCALE * share / max(1, mask.sum())
    return Rows(inputs.quantised(_rows_of(streams)), weight, number)


def _fitted(rows: Rows) -> tuple[FloatArray, float]:
    """Weights [I] and bias of the logit of "it is a slip", for quantised inputs."""
    mean = np.average(rows.x, axis=0, weights=rows.weight)
    scale = np.sqrt(np.average((rows.x - mean) ** 2, axis=0, weights=rows.weight)) + 1.0
    x, kept = (rows.x - mean) / scale, np.ones(len(rows.slip), dtype=np.bool_)
    for _ in range(ROUNDS):
        model = LogisticRegression(C=INVERSE_PENALTY, max_iter=MOST_STEPS)
        with warnings.catch_warnings():
            warnings.simplefilter("ignore", ConvergenceWarning)
            model.fit(x[kept], rows.slip[kept] >= 0, sample_weight=rows.weight[kept])
        kept = _best_of_slips(rows.slip, x @ model.coef_[0])
    weights = model.coef_[0] / scale
    return weights, float(model.intercept_[0] - mean @ weights)


def _best_of_slips(slip: npt.NDArray[np.int64], logit: FloatArray) -> npt.NDArray[np.bool_]:
    """[N] all rows of no slip, and the TOP rows of every slip."""
    order = np.lexsort((-logit, slip))
    ordered = slip[order]
    first = np.searchsorted(ordered, ordered)
    kept = np.zeros(len(slip), dtype=np.bool_)
    kept[order] = (ordered < 0) | (np.arange(len(slip)) - first < TOP)
    return kept


def _in_whole_numbers(inputs: Inputs, weights: FloatArray, bias: float) -> Correction:
    """The largest whole numbers that float32 still adds exactly."""
    room = EXACT_FLOAT32 - (INPUT_MOST + 1) * len(weights)
    size = min(
        room / (INPUT_MOST * np.abs(weights).sum() + abs(bias) + MOST_NATS),
        (WEIGHT_MOST - 1) / (np.abs(weights).max() + 1e-9),
    )
    whole = np.zeros((len(weights), 2), dtype=np.float32)
    whole[:, 1] = np.round(weights * size)
    layer = Layer(
        whole,
        np.array([0.0, np.round(bias * size)], dtype=np.float32),
        np.array([1.0, LOGIT_STEPS / size], dtype=np.float32),
    )
    return Correction(Network(inputs, (layer,), votes_in_all=1))


def moved(correction: Correction, nats: float) -> Correction:
    """The same with its logit moved: more above 0 leaves more votes to risky slip."""
    network = correction.network
    (layer,) = network.layers
    bias = layer.bias.copy()
    bias[1] = np.round(bias[1] + nats * LOGIT_STEPS / layer.scale[1])
    return Correction(
        Network(network.inputs, (Layer(layer.weights, bias, layer.scale),), votes_in_all=1)
    )
