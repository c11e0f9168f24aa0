"""Evidence for an adaptation: the samples that a model may call risky, and whether they are slips.

A sample can only be called risky with at least a quarter of the votes for it (or more, by label
weights), so all other samples are left out: a correction cannot change their label.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.edge_runtime.contract import GRASP, RISKY_SLIP, BoolArray
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.graph import Outputs
from holdfast.edge_runtime.model import Model
from holdfast.evaluation.alarms import Answers
from holdfast.evaluation.event_scores import COLLAR_S
from holdfast.evaluation.methods import without_samples
from holdfast.evaluation.model_outputs import everywhere, risky_permille, steps_with
from holdfast.evaluation.truths import voluntary_actions
from holdfast.evaluation.window_scores import require_model_fits
from holdfast.export.correction import Correction, corrected_votes
from holdfast.export.reference import FloatRows, IntArray, riskier_argmax, situation_votes, weighted
from holdfast.training.recording import DataSet, Recording
from holdfast.training.say import Part, ignored

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
        streams += [stream_of(one, out, weights) for one, out in zip(some, computed, strict=True)]
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
    row = np.flatnonzero(known & ((permille >= LEAST_PERMILLE) | (situation == RISKY_SLIP)))
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


def corrected(stream: Stream, correction: Correction | None, weights: LabelWeights) -> Answers:
    """The answers after a correction."""
    if correction is None or not len(stream.row):
        return stream.answers
    votes = corrected_votes(correction, stream.features, stream.votes)
    situation, permille = stream.answers.situation.copy(), stream.answers.risky_permille.copy()
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
