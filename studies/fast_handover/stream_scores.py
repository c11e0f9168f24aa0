"""Alarms on whole streams: each idea's answers, its threshold, and the figures of each set."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict

import numpy as np

from holdfast.core.contract import SITUATIONS, BoolArray
from holdfast.core.reading import Json
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.alarms import (
    Answers,
    EventScores,
    act_requests,
    choose_confidence,
    event_scores,
    match_alarms,
)
from holdfast.evaluation.methods import (
    MethodResult,
    method_figures,
    method_result,
    together,
)
from holdfast.evaluation.trials import Grasp, LabelledTrial
from holdfast.export.spec import HISTORY_S
from holdfast.training.plan import HIGH_CONFIDENCE
from studies.fast_handover.ideas import Idea
from studies.fast_handover.learners import Answer
from studies.fast_handover.sets import CHOOSE, EVALUATED, Streams

MOST_FALSE_PER_MIN = 0.5
ONE_SAMPLE = HIGH_CONFIDENCE["forest"]
"""The rules of a decision; each learner gets a threshold of its own."""
CALIBRATION_PASSES = 8
BOX_GAP_M = 0.01
"""From the object to the box before it is put down, as the scenes have it."""
KEPT = (
    "events",
    "recall",
    "recall_ci",
    "in_time",
    "false_per_min",
    "false_per_min_ci",
    "safe_acts_called",
    "delay_ms",
)
"""What a row keeps of the figures of a method."""
Sets = Mapping[str, Streams]


def alarm_figures(
    idea: Idea, sets: Sets, learned: Mapping[str, Answer], seed: int
) -> Json:
    """Thresholds and figures of every evaluated set, at the threshold that CHOOSE gives.

    state_delay_ms: from load onset to the first risky state, without the decision's own rules.
    """
    veto = idea.decision == "veto"
    answers = {name: answers_of(one, learned[name], veto) for name, one in sets.items()}
    permille = _thresholds(idea, sets, answers)
    results = {
        name: called(sets[name], answers[name], permille[name]) for name in EVALUATED
    }
    figures: Json = {"permille": permille}
    for name, result in results.items():
        found = method_figures(result, sets[name].trials, seed)
        figures[name] = picked(found, (*KEPT, "specificity"))
    unseen = event_scores(together([results["p1"], results["p2"]]).matches, seed=seed)
    shown = ("events", "recall", "recall_ci", "false_per_min")
    figures["unseen_style"] = picked(unseen, shown)
    states = [
        match_alarms(one.recording, _state(one, permille["author"]))
        for one in answers["author"]
    ]
    delay = picked(event_scores(states, seed=seed), ["delay_ms"])
    return figures | {"state_delay_ms": delay["delay_ms"]}


def picked(figures: EventScores, names: Sequence[str]) -> Json:
    """Some of the figures, as JSON has them."""
    whole = asdict(figures)
    return {name: whole[name] for name in names}


def called(streams: Streams, answers: Sequence[Answers], permille: int) -> MethodResult:
    """What is called at a threshold, by the rules of the shipped models."""
    requests = [on[:, 0] for on in act_requests(answers, ONE_SAMPLE, [permille])]
    return method_result(streams.trials, requests)


def _thresholds(
    idea: Idea, sets: Sets, answers: Mapping[str, Sequence[Answers]]
) -> dict[str, int]:
    """The threshold of each evaluated set, and of CHOOSE, in thousandths of the votes."""
    permille = choose_confidence(answers[CHOOSE], ONE_SAMPLE, MOST_FALSE_PER_MIN)
    personal = idea.decision == "personal"
    return {
        name: _personal(sets[name], answers[name], permille) if personal else permille
        for name in EVALUATED
    } | {CHOOSE: permille}


def _state(one: Answers, permille: int) -> BoolArray:
    on: BoolArray = (one.situation == len(SITUATIONS) - 1) & (
        one.risky_permille >= permille
    )
    return on


def answers_of(streams: Streams, learned: Answer, veto: bool = False) -> list[Answers]:
    """The answers of each trial, unknown until its history is full."""
    ends = np.cumsum(streams.lengths)[:-1]
    answers = []
    for one, situation, risky in zip(
        streams.trials,
        np.split(learned[0], ends),
        np.split(learned[1], ends),
        strict=True,
    ):
        rate_hz = one.recording.rate_hz
        situation[: int(np.floor(HISTORY_S * rate_hz + 1e-9))] = UNKNOWN
        if veto:
            risky = np.where(_opening(one, len(risky)), -1, risky)
        answers.append(Answers(one.recording, situation, risky))
    return answers


def _opening(trial: LabelledTrial, n: int) -> BoolArray:
    """[T] after the hand's own opening command, which a scene draws and no sensor shows."""
    opens_s = [
        opens for grasp in trial.grasps if (opens := opens_at_s(grasp)) is not None
    ]
    times = np.arange(n) / trial.recording.rate_hz
    return times >= opens_s[0] if len(opens_s) == 1 else np.zeros(n, dtype=np.bool_)


def opens_at_s(grasp: Grasp) -> float | None:
    """When the hand gets its command to open, from what was drawn; None where it gets none."""
    drawn = grasp.truth.get("drawn", {})
    if (
        grasp.truth.get("action") not in ("pass", "put-down")
        or "open_after_s" not in drawn
    ):
        return None
    acts_s = drawn["close_at_s"] + drawn["closing_s"] + drawn["hold_s"]
    waits_s = (
        drawn["wait_s"]
        if grasp.truth.get("action") == "pass"
        else BOX_GAP_M / drawn["box_m_s"]
    )
    return float(acts_s + waits_s + drawn["open_after_s"])


def _personal(streams: Streams, answers: Sequence[Answers], permille: int) -> int:
    """A style's own threshold: above what its first hand-overs reach, at least the common one."""
    passes = [
        one
        for trial, one in zip(streams.trials, answers, strict=True)
        if trial.recording.action == "pass"
    ]
    reached = [
        int(one.risky_permille[one.situation == len(SITUATIONS) - 1].max(initial=0))
        for one in passes[:CALIBRATION_PASSES]
    ]
    return min(max([permille, *(most + 1 for most in reached)]), 1000)
