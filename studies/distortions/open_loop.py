"""A model file run over the distorted trials: what became of each trial, and the figures."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from benchmarks.paired import paired_change
from holdfast.core.contract import NOTHING, BoolArray, Json
from holdfast.data.metrics import Interval
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.alarms import (
    EventMatch,
    event_scores,
    match_alarms,
    requests_at,
)
from holdfast.evaluation.formats import share
from holdfast.evaluation.model_outputs import (
    OUTPUTS,
    ModelOutputs,
    everywhere,
    read_outputs,
    steps_with,
)
from holdfast.evaluation.trials import voluntary_actions
from holdfast.simulation.loop.closed_loop import model_of
from studies.distortions.statistics import mean_interval
from studies.distortions.table import by_name
from studies.distortions.trials import NOTHING_ACTION, felt_set, recording_of

COLUMNS = ("found", "called")
"""Yes-or-no outcomes of single events and actions, which compare pair by pair."""


@dataclass(frozen=True)
class OpenOutcomes:
    """What became of the set; keys are "trial, number in it".

    found: of slips; called: of voluntary actions. empty: share of an open hand's samples that is
    called nothing, by trial. unknown: share of the samples of all others without an answer.
    """

    found: dict[str, bool]
    called: dict[str, bool]
    false_per_min: float
    false_per_min_ci: Interval | None
    empty: tuple[float, ...]
    unknown: float


@dataclass(frozen=True)
class OpenJob:
    """The open-loop part of one distortion."""

    model: ModelChoice
    name: str
    card: str
    trials: int | None
    seed: int

    def __call__(self) -> OpenOutcomes:
        """Run it."""
        model = model_of(self.model)
        of = felt_set(self.card, self.trials, self.seed)
        distortion = by_name()[self.name]
        preparation = model.card.preparation
        recordings = []
        for trial in of.trials:
            recordings.append(recording_of(of, trial, distortion, preparation))

        # No check of the rate: a hand that samples at another one does not know it.
        computed = everywhere(steps_with(model, OUTPUTS), recordings)
        outputs = read_outputs(model, recordings, computed)
        rules = model.card.decision
        requests = requests_at(outputs, rules, rules.min_risky_permille)

        return outcomes_of(outputs, requests, model.card.settle_samples, self.seed)


def outcomes_of(
    outputs: Sequence[ModelOutputs],
    requests: Sequence[BoolArray],
    settle: int,
    seed: int,
) -> OpenOutcomes:
    """What became of trials. requests [T] each: whether an act is requested."""
    found: dict[str, bool] = {}
    called: dict[str, bool] = {}
    matches: list[EventMatch] = []
    held = []
    for one, on in zip(outputs, requests, strict=True):
        recording = one.recording
        if recording.action == NOTHING_ACTION:
            continue
        held.append(one)
        match = match_alarms(recording, on)
        matches.append(match)
        for number, event in enumerate(match.outcomes):
            found[f"{recording.trial_id}, {number}"] = event.alarm_s is not None
        for number, action in enumerate(voluntary_actions(recording)):
            was_called = on[action.first : action.stop].any()
            called[f"{recording.trial_id}, {number}"] = bool(was_called)

    scores = event_scores(matches, seed=seed)
    return OpenOutcomes(
        found=found,
        called=called,
        false_per_min=scores.false_per_min or 0.0,
        false_per_min_ci=scores.false_per_min_ci,
        empty=_empty(outputs, settle),
        unknown=_unknown(held),
    )


def _empty(outputs: Sequence[ModelOutputs], settle: int) -> tuple[float, ...]:
    """By trial of the open hand, the share of the samples after the start that is nothing."""
    shares = []
    for one in outputs:
        if one.recording.action == NOTHING_ACTION:
            shares.append(float(np.mean(one.situation[settle:] == NOTHING)))
    return tuple(shares)


def _unknown(outputs: Sequence[ModelOutputs]) -> float:
    samples = 0
    unknown = 0
    for one in outputs:
        samples += len(one.situation)
        unknown += int(np.sum(one.situation == UNKNOWN))
    return unknown / samples if samples else 0.0


def open_figures(of: OpenOutcomes, unchanged: OpenOutcomes) -> Json:
    """The figures of a row, and by how much they differ from the unchanged set."""
    figures: Json = {
        "false_per_min": of.false_per_min,
        "false_per_min_ci": of.false_per_min_ci,
        "open_hand": float(np.mean(of.empty)) if of.empty else None,
        "open_hand_ci": mean_interval(of.empty),
        "unknown": of.unknown,
    }
    for name in COLUMNS:
        outcomes = getattr(of, name)
        counted = share(list(outcomes.values()))
        figures[name] = counted.share
        figures[f"{name}_ci"] = counted.share_ci
        figures[f"{name}_of"] = counted.n
        change = paired_change(outcomes, getattr(unchanged, name))
        figures[f"{name}_change"], figures[f"{name}_change_ci"] = change
    return figures
