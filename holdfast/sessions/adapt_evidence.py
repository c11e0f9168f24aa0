"""Evidence for an adaptation, and the logistic rule of a correction that is fitted on it.

Evidence is the samples that a model may call risky, and whether they are slips. A sample can only
be called risky with at least a quarter of the votes for it (or more, by label weights), so all
other samples are left out: a correction cannot change their label. The rule is fitted on a person's
samples together with those of other slips.

A slip must be called once, while a hand-over must not be called at any of its samples. So after a
first fit only the TOP best samples of each slip count, and the rule is fitted again on these, some
times. All samples that are no slip count throughout (multiple-instance learning: Andrews,
Tsochantaridis, Hofmann, NIPS 2002).
"""

from __future__ import annotations

import warnings
from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from sklearn.exceptions import ConvergenceWarning
from sklearn.linear_model import LogisticRegression

from holdfast.core.contract import GRASP, RISKY_SLIP, BoolArray, FloatArray
from holdfast.core.progress import Part, ignored
from holdfast.data.recording import DataSet, Recording
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.alarms import COLLAR_S, RecordingAnswers, within_event
from holdfast.evaluation.model_outputs import (
    everywhere,
    require_model_fits,
    risky_permille,
    steps_with,
)
from holdfast.evaluation.trials import voluntary_actions, without_samples
from holdfast.step.heads import (
    Correction,
    FloatRows,
    riskier_argmax,
    situation_votes,
    weighted,
)
from holdfast.step.network import (
    INPUT_MOST,
    LOGIT_STEPS,
    Float32Array,
    InputScale,
    IntArray,
    Layer,
    Network,
)
from holdfast.training.network_fit import whole_weights

LEAST_PERMILLE = 250
"""Of the votes for risky slip. With four situations, the label needs at least a quarter."""
AT_ONCE = 32
"""Recordings whose features are in memory together."""
NO_EVENT = -1
"""In place of a slip's number, at samples that belong to none."""
OUTPUTS = ("situation", "votes", "unknown", "features")
"""Of the graph, at every sample."""
TOP = 3
"""Samples of each slip that stand for it. With one, a single outlier would be the slip."""
ROUNDS = 4
"""Fits, each on the samples that the one before ranked best."""
OF_PERSON = 0.9
"""Share of the weight of all samples that are no slip, for those of the person."""
SCALE = 2000.0
"""Sum of the weights of slips, and of the others; with INVERSE_PENALTY it says how small the
correction stays."""
INVERSE_PENALTY = 0.03
MOST_STEPS = 100
"""Of a fit: held-out trials judge the rule, so its last digits do not matter."""
LEAST_KNEE = 1e-6
"""Keeps the division finite for an input that is always zero."""
MOST_NATS = 10.0
"""How far `moved` may move a logit, and still add exactly."""
LabelWeights = tuple[float, ...] | None
"""Of each situation's votes for the label; None where all count the same."""


@dataclass(frozen=True)
class CandidateRows:
    """The base's answers on one recording, and its candidate rows.

    answers: of the base. row [M]: samples that may be called risky. features [M, F]. votes [M, K].
    event [M]: which risky event of the recording each belongs to, or NO_EVENT.
    """

    answers: RecordingAnswers
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
    """What a person's recordings hold, for the model card and for the error if it is too little."""

    trials: int
    hand_overs: int
    holding_s: float
    slips: int


def streams_of(
    model: Model, data: DataSet, part: Part = ignored
) -> list[CandidateRows]:
    """A model's answers and candidate rows on a set. Raises ChannelError, UnitError, RateError."""
    require_model_fits(model, data)
    streams: list[CandidateRows] = []
    recordings = data.recordings

    for first in range(0, len(recordings), AT_ONCE):
        # Features of a whole set do not fit into the memory of a small computer.
        batch = recordings[first : first + AT_ONCE]
        computed = everywhere(steps_with(model, OUTPUTS), batch)
        for recording, outputs in zip(batch, computed, strict=True):
            streams.append(stream_of(recording, outputs))
        part(len(streams) / len(recordings))

    return streams


def label_weights(model: Model) -> LabelWeights:
    """What each situation's votes count for the label; None for the same."""
    given = model.card.raw["heads"]["situation"].get("label_weights")
    return None if given is None else tuple(given)


def stream_of(recording: Recording, outputs: Outputs) -> CandidateRows:
    """The candidate rows of a recording. outputs: OUTPUTS at every sample."""
    votes = outputs["votes"].astype(np.int64)
    permille = risky_permille(votes)
    known = ~outputs["unknown"]
    situation = np.where(known, outputs["situation"], UNKNOWN)
    # Label weights may let fewer votes win, so the label itself counts too.
    may_be_risky = (permille >= LEAST_PERMILLE) | (situation == RISKY_SLIP)
    row = np.flatnonzero(known & may_be_risky)
    t_s = row / recording.rate_hz
    event = np.full(len(row), NO_EVENT)

    for k, slip in enumerate(recording.events):
        # The collar is that of the alarms: what counts as a found slip there is a slip here.
        event[within_event(slip, t_s, COLLAR_S)] = k

    # The samples themselves are large and no longer needed.
    answers = RecordingAnswers(without_samples(recording), situation, permille)
    features = outputs["features"][row]
    return CandidateRows(answers, row, features, votes[row], event)


def corrected(
    stream: CandidateRows, correction: Correction | None, weights: LabelWeights
) -> RecordingAnswers:
    """The answers after a correction."""
    if correction is None or not len(stream.row):
        return stream.answers
    votes = correction.corrected(stream.features, stream.votes)
    situation = stream.answers.situation.copy()
    permille = stream.answers.risky_permille.copy()
    # Ties go to the riskier situation, as in the graph.
    weighed = weighted(situation_votes(votes), weights)
    situation[stream.row] = riskier_argmax(weighed)
    permille[stream.row] = risky_permille(votes)
    return RecordingAnswers(stream.recording, situation, permille)


def counts_of(recordings: Sequence[Recording]) -> PersonCounts:
    """Hand-overs (passes with a voluntary action), seconds of holding, slips."""
    hand_overs = 0
    holding_s = 0.0
    slips = 0
    for recording in recordings:
        # Only a pass is a hand-over; a put-down has no second hand.
        if recording.action == "pass":
            hand_overs += len(voluntary_actions(recording))
        for phase in recording.phases:
            if phase.situation == GRASP:
                holding_s += (phase.stop - phase.first) / recording.rate_hz
        slips += len(recording.events)

    return PersonCounts(len(recordings), hand_overs, round(holding_s, 1), slips)


def fit_correction(
    person: Sequence[CandidateRows], others: Sequence[CandidateRows], votes_in_all: int
) -> Correction:
    """The correction for a person. others: recordings with slips, of any person."""
    # The inputs are scaled by the others, who are many; a person's eight trials are too few.
    inputs = _inputs(others, votes_in_all)
    streams = [*person, *others]
    slip = _slip_numbers(streams)
    n_person = sum(len(stream.row) for stream in person)
    row_weights = _row_weights(slip, n_person)
    # Fitted on what the graph will compute with: quantised inputs.
    x = inputs.quantised(_rows_of(streams))
    weights, bias = _fitted(x, slip, row_weights)
    return _in_whole_numbers(inputs, weights, bias)


def _rows_of(streams: Sequence[CandidateRows]) -> Float32Array:
    return np.concatenate([Correction.rows(one.features, one.votes) for one in streams])


def _inputs(others: Sequence[CandidateRows], votes_in_all: int) -> InputScale:
    """A knee at each input's median magnitude; of votes, at all votes."""
    x = _rows_of(others)
    n_classes = others[0].votes.shape[1]
    magnitude = np.abs(x)
    knee = np.median(magnitude, axis=0) + LEAST_KNEE
    # The last inputs are the votes of each class.
    knee[-n_classes:] = votes_in_all
    most = np.full(x.shape[1], INPUT_MOST, dtype=np.float32)
    return InputScale(knee.astype(np.float32), most, np.zeros_like(most))


def _slip_numbers(streams: Sequence[CandidateRows]) -> IntArray:
    """[N] the number of each row's slip among those of all recordings, or NO_EVENT."""
    numbers = []
    count = 0
    for stream in streams:
        of_slip = stream.event != NO_EVENT
        numbers.append(np.where(of_slip, stream.event + count, NO_EVENT))
        count += len(stream.recording.events)
    return np.concatenate(numbers)


def _row_weights(slip: IntArray, n_person: int) -> FloatArray:
    """[N] slips weigh as much as the rest, and the person's (the first rows) most of the rest."""
    of_slip = slip != NO_EVENT
    of_person = ~of_slip & (np.arange(len(slip)) < n_person)
    weight = np.zeros(len(slip))
    # A group shares its weight: how many rows it has does not matter.
    for rows, share in (
        (of_slip, 1.0),
        (of_person, OF_PERSON),
        (~of_slip & ~of_person, 1.0 - OF_PERSON),
    ):
        weight[rows] = SCALE * share / max(1, rows.sum())
    return weight


def _fitted(
    x: Float32Array, slip: IntArray, weight: FloatArray
) -> tuple[FloatArray, float]:
    """Weights [I] and bias of the logit of "it is a slip". x [N, I]: quantised inputs."""
    mean = np.average(x, axis=0, weights=weight)
    # Inputs are whole numbers, so a deviation of 1 is small: one that never varies is not blown up.
    variance = np.average((x - mean) ** 2, axis=0, weights=weight)
    scale = np.sqrt(variance) + 1.0
    # Standardised, so that one penalty fits all inputs.
    scaled = (x - mean) / scale
    kept = np.ones(len(slip), dtype=np.bool_)

    for _ in range(ROUNDS):
        model = LogisticRegression(C=INVERSE_PENALTY, max_iter=MOST_STEPS)
        with warnings.catch_warnings():
            # MOST_STEPS ends the fit early on purpose.
            warnings.simplefilter("ignore", ConvergenceWarning)
            is_slip = slip[kept] >= 0
            model.fit(scaled[kept], is_slip, sample_weight=weight[kept])
        # A slip must be called once: its best samples under this fit stand for it in the next.
        kept = _best_of_slips(slip, scaled @ model.coef_[0])

    weights = model.coef_[0] / scale
    # The weights are for unscaled inputs, which is what the graph computes with.
    return weights, float(model.intercept_[0] - mean @ weights)


def _best_of_slips(slip: IntArray, logit: FloatArray) -> BoolArray:
    """[N] all rows of no slip, and the TOP rows of every slip."""
    order = np.lexsort((-logit, slip))
    ordered = slip[order]
    # In this order a slip's rows stand together, the best first.
    first_of_slip = np.searchsorted(ordered, ordered)
    place_in_slip = np.arange(len(slip)) - first_of_slip
    kept = np.zeros(len(slip), dtype=np.bool_)
    kept[order] = (ordered == NO_EVENT) | (place_in_slip < TOP)
    return kept


def _in_whole_numbers(
    inputs: InputScale, weights: FloatArray, bias: float
) -> Correction:
    """The largest whole numbers that float32 still adds exactly, MOST_NATS further too."""
    most_bias = np.array([abs(bias) + MOST_NATS])
    rule, _, (steps,) = whole_weights(weights[:, None], most_bias, INPUT_MOST)
    # Two logits: that of "no slip" stays zero, as in logistic regression.
    whole = np.concatenate([np.zeros_like(rule), rule], axis=1)
    biases = np.array([0.0, np.round(bias * steps)], dtype=np.float32)
    # Back from the size of the weights to the steps in which the graph counts logits.
    scales = np.array([1.0, LOGIT_STEPS / steps], dtype=np.float32)
    layer = Layer(whole, biases, scales)
    return Correction(Network(inputs, (layer,), votes_in_all=1))


def with_offset(correction: Correction, nats: float) -> Correction:
    """The same with its logit moved: more above 0 leaves more votes to risky slip."""
    network = correction.network
    (layer,) = network.layers
    bias = layer.bias.copy()
    # The bias counts in whole steps too, so that the sum stays exact.
    steps = nats * LOGIT_STEPS / layer.scale[1]
    bias[1] = np.round(bias[1] + steps)

    changed = replace(layer, bias=bias)
    return Correction(replace(network, layers=(changed,)))
