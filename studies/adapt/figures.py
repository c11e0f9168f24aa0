"""Figures of one way of answering a set: alarms with intervals over trials (or people)."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import BoolArray
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.evaluation.alarms import (
    Answers,
    act_requests,
    event_scores,
    match_alarms,
    ratio_interval,
)
from holdfast.evaluation.trials import voluntary_actions
from holdfast.training.figures import Interval
from holdfast.training.metrics import draw_groups

DRAWS = 1000
BEFORE = "as it is"
THRESHOLD = "threshold alone"
WHOLE = "adapted"
"""Ways of answering."""


@dataclass(frozen=True)
class WayFigures:
    """Of all persons of a style, each on the same trials. called: share of voluntary actions.

    by_person: called and recall of each person.
    """

    called: float | None
    called_ci: Interval | None
    actions: int
    recall: float | None
    recall_ci: Interval | None
    events: int
    false_per_min: float | None
    false_per_min_ci: Interval | None
    before_gross_slip: float | None
    delay_ms: float | None
    by_person: list[tuple[float | None, float | None]]


Way = tuple[Sequence[Answers], DecisionRules]
"""The answers of one person's file on a set, and its decision rules."""


def way_figures(persons: Sequence[Way], seed: int = 0) -> WayFigures:
    """Figures over persons. A trial answered by several persons' files is one group."""
    answers = [one for of_one, _ in persons for one in of_one]
    requests = [on for way in persons for on in _requests(way)]
    scores = event_scores(
        [
            match_alarms(one.recording, on)
            for one, on in zip(answers, requests, strict=True)
        ],
        seed=seed,
    )
    called, interval, actions = _called(answers, requests, seed)
    return WayFigures(
        called=called,
        called_ci=interval,
        actions=actions,
        recall=scores.recall,
        recall_ci=scores.recall_ci,
        events=scores.events,
        false_per_min=scores.false_per_min,
        false_per_min_ci=scores.false_per_min_ci,
        before_gross_slip=scores.in_time,
        delay_ms=scores.delay_ms.p50 if scores.delay_ms else None,
        by_person=[_of_person(one) for one in persons],
    )


def _requests(way: Way) -> list[BoolArray]:
    answers, rules = way
    return [
        one[:, 0] for one in act_requests(answers, rules, [rules.min_risky_permille])
    ]


def _of_person(way: Way) -> tuple[float | None, float | None]:
    requests = _requests(way)
    matches = [
        match_alarms(one.recording, on)
        for one, on in zip(way[0], requests, strict=True)
    ]
    return _called(way[0], requests, 0)[0], event_scores(matches, n_draws=2).recall


def _called(
    answers: Sequence[Answers], requests: Sequence[BoolArray], seed: int
) -> tuple[float | None, Interval | None, int]:
    """Share of voluntary actions with a request, its interval over groups, and how many."""
    groups = np.unique([one.recording.group for one in answers], return_inverse=True)[1]
    sums = np.zeros((groups.max(initial=-1) + 1, 2))
    for group, one, on in zip(groups, answers, requests, strict=True):
        for action in voluntary_actions(one.recording):
            sums[group] += [on[action.first : action.stop].any(), 1]
    called, actions = sums.sum(axis=0)
    drawn = draw_groups(len(sums), DRAWS, seed) @ sums if len(sums) > 1 else None
    return (
        (called / actions if actions else None),
        ratio_interval(drawn, 0, 1),
        int(actions),
    )
