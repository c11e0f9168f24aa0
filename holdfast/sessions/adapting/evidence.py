"""Evidence for an adaptation: the samples that a model may call risky, and whether they are slips.

A sample can only be called risky with at least a quarter of the votes for it (or more, by label
weights), so all other samples are left out: a correction cannot change their label.

The logistic rule of a correction, fitted on a person's samples beside those of other slips.

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

from holdfast.core.contract import GRASP, RISKY_SLIP, BoolArray, FloatArray
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.alarms import Answers
from holdfast.evaluation.event_scores import COLLAR_S
from holdfast.evaluation.methods import without_samples
from holdfast.evaluation.model_outputs import everywhere, risky_permille, steps_with
from holdfast.evaluation.truths import voluntary_actions
from holdfast.evaluation.window_scores import require_model_fits
from holdfast.export.correction import Correction, corrected_votes, rows_of
from holdfast.export.heads import FloatRows, riskier_argmax, situation_votes, weighted
from holdfast.export.network import (
    EXACT_FLOAT32,
    INPUT_MOST,
    LOGIT_STEPS,
    WEIGHT_MOST,
    Float32Array,
    Inputs,
    IntArray,
    Layer,
    Network,
)
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import DataSet, Recording

LEAST_PERMILLE = 250
AT_ONCE = 32
"""Recordings whose features are in memory together."""
NO_EVENT = -1
OUTPUTS = ("situation", "votes", "unknown", "features")
LabelWeights = tuple[float, ...] | None


@dataclass(frozen=True)
class Stream:
    """The base's answers on one recording, and its candidate rows.

    answers: of the base. row [M]: samples that may be called risky. features [M, F]. votes [M, K].
    event [M]: which risky event of the recording each belongs to, or NO_EVENT.
    """

    answers: Answers
    row: IntArray
    features: FloatRows
    votes: IntArray
    event: IntArray

    @property
    def recording(self) -> Recording:
        """The recording, without its samples."""
        return self.answers.recording


@dataclass(frozen=True)
class PersonCounts:
    """What a person's recording holds, for the card and for the error where it is too little."""

    trials: int
    hand_overs: int
    holding_s: float
    slips: int


def streams_of(model: Model, data: DataSet, part: Part = ignored) -> list[Stream]:
    """A model's answers and candidate rows on a set. Raises ChannelError, UnitError, RateError."""
    require_model_fits(model, data)
    streams: list[Stream] = []
    weights, recordings = label_weights(model), data.recordings
    for first in range(0, len(recordings), AT_ONCE):
        some = recordings[first : first + AT_ONCE]
        computed = everywhere(steps_with(model, OUTPUTS), some)
        streams += [
            stream_of(one, out, weights)
            for one, out in zip(some, computed, strict=True)
        ]
        part(len(streams) / len(recordings))
    return streams


def label_weights(model: Model) -> LabelWeights:
    """What each situation's votes count for the label; None for the same."""
    given = model.card.raw["heads"]["situation"].get("label_weights")
    return None if given is None else tuple(given)


def stream_of(recording: Recording, out: Outputs, weights: LabelWeights) -> Stream:
    """The candidate rows of a recording. out: OUTPUTS at every sample."""
    votes = out["votes"].astype(np.int64)
    permille = risky_permille(votes)
    known = ~out["unknown"]
    situation = np.where(known, out["situation"], UNKNOWN)
    row = np.flatnonzero(
        known & ((permille >= LEAST_PERMILLE) | (situation == RISKY_SLIP))
    )
    light = without_samples(recording)
    return Stream(
        Answers(light, situation, permille),
        row,
        out["features"][row],
        votes[row],
        event_of(light, row),
    )


def event_of(recording: Recording, row: IntArray) -> IntArray:
    """[M] the risky event of a recording that each row belongs to, or NO_EVENT."""
    t_s = row / recording.rate_hz
    event = np.full(len(row), NO_EVENT)
    for k, one in enumerate(recording.events):
        event[(t_s >= one.onset_s - COLLAR_S) & (t_s <= one.end_s + COLLAR_S)] = k
    return event


def corrected(
    stream: Stream, correction: Correction | None, weights: LabelWeights
) -> Answers:
    """The answers after a correction."""
    if correction is None or not len(stream.row):
        return stream.answers
    votes = corrected_votes(correction, stream.features, stream.votes)
    situation, permille = (
        stream.answers.situation.copy(),
        stream.answers.risky_permille.copy(),
    )
    situation[stream.row] = riskier_argmax(weighted(situation_votes(votes), weights))
    permille[stream.row] = risky_permille(votes)
    return Answers(stream.recording, situation, permille)


def counts_of(recordings: Sequence[Recording]) -> PersonCounts:
    """Hand-overs (passes with a voluntary action), seconds of holding, slips."""
    passes = [one for one in recordings if one.action == "pass"]
    holding_s = sum(
        (phase.stop - phase.first) / one.rate_hz
        for one in recordings
        for phase in one.phases
        if phase.situation == GRASP
    )
    return PersonCounts(
        trials=len(recordings),
        hand_overs=sum(len(voluntary_actions(one)) for one in passes),
        holding_s=round(holding_s, 1),
        slips=sum(len(one.events) for one in recordings),
    )


def is_slip(event: IntArray) -> BoolArray:
    """[M] whether each row belongs to a slip."""
    return np.asarray(event != NO_EVENT)


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


def _weighed(
    person: Sequence[Stream], others: Sequence[Stream], inputs: Inputs
) -> Rows:
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


def _best_of_slips(
    slip: npt.NDArray[np.int64], logit: FloatArray
) -> npt.NDArray[np.bool_]:
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
        Network(
            network.inputs, (Layer(layer.weights, bias, layer.scale),), votes_in_all=1
        )
    )
