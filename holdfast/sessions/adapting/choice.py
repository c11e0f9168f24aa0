"""The operating point of an adaptation: chosen on trials that its correction has not seen.

The correction is fitted in turn without a part of all trials and answers that part. Among the
operating points that keep the recall on the others' slips, the one is taken that calls fewest of
the person's samples. (Eight hand-overs called or not are too coarse a measure to choose by.)
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from holdfast.core.contract import RISKY_SLIP, BoolArray
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.evaluation.alarms import Answers, act_requests
from holdfast.evaluation.event_scores import match_alarms
from holdfast.evaluation.truths import voluntary_actions
from holdfast.export.correction import Correction
from holdfast.sessions.adapting.evidence import (
    LabelWeights,
    Stream,
    corrected,
    fit_correction,
    moved,
)

LEAST_RECALL = 0.99
"""Of the others' slips, with the trial held out; or the base's own recall where that is less."""
FOLDS = 4
NATS = (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
PERMILLE, FINER = (400, 500, 600, 700), tuple(range(400, 1000, 50))
"""Thresholds with a correction, whose place moves more finely, and without one."""
LONGER = (0, 1)
"""Samples that an act needs beyond the base's."""


@dataclass(frozen=True)
class Reached:
    """What an operating point reaches on held-out trials.

    recall, before_gross_slip: of the others' slips. hand_overs, called: of the person.
    called_samples: of the person, at which an act may begin.
    """

    recall: float
    before_gross_slip: float
    hand_overs: int
    called: int
    called_samples: int


@dataclass(frozen=True)
class OperatingPoint:
    """nats: how far the correction's logit is moved, None without a correction."""

    nats: float | None
    rules: DecisionRules
    reached: Reached


def choose(
    person: Sequence[Stream],
    others: Sequence[Stream],
    base: DecisionRules,
    weights: LabelWeights,
    votes_in_all: int | None,
) -> OperatingPoint:
    """The operating point. votes_in_all: of the model; None for decision parameters alone."""
    held = (
        [None] * FOLDS
        if votes_in_all is None
        else list(_held_out(person, others, votes_in_all))
    )
    permille = FINER if votes_in_all is None else PERMILLE
    points = [
        point
        for nats in ((None,) if votes_in_all is None else NATS)
        for point in _points(person, others, base, weights, held, nats, permille)
    ]
    least = min(LEAST_RECALL, _of_base(person, others, base, weights).recall)
    enough = [one for one in points if one.reached.recall >= least]
    if not enough:
        return max(points, key=lambda one: one.reached.recall)
    return min(enough, key=_cost)


def correction_at(
    point: OperatingPoint,
    person: Sequence[Stream],
    others: Sequence[Stream],
    votes_in_all: int,
) -> Correction | None:
    """The correction of an operating point, fitted on all trials; None without one."""
    if point.nats is None:
        return None
    return moved(fit_correction(person, others, votes_in_all), point.nats)


def _cost(point: OperatingPoint) -> tuple[float, ...]:
    reached = point.reached
    return reached.called_samples, -reached.before_gross_slip, -reached.recall


def _of_base(
    person: Sequence[Stream],
    others: Sequence[Stream],
    base: DecisionRules,
    weights: LabelWeights,
) -> Reached:
    (point,) = _points(
        person,
        others,
        base,
        weights,
        [None] * FOLDS,
        None,
        (base.min_risky_permille,),
        (0,),
    )
    return point.reached


def _held_out(
    person: Sequence[Stream], others: Sequence[Stream], votes_in_all: int
) -> Iterator[Correction]:
    """For each fold, the correction of all trials outside of it."""
    for fold in range(FOLDS):
        yield fit_correction(
            _without(person, fold), _without(others, fold), votes_in_all
        )


def _without(streams: Sequence[Stream], fold: int) -> list[Stream]:
    return [one for k, one in enumerate(streams) if k % FOLDS != fold]


def _points(
    person: Sequence[Stream],
    others: Sequence[Stream],
    base: DecisionRules,
    weights: LabelWeights,
    held: Sequence[Correction | None],
    nats: float | None,
    permille: Sequence[int],
    longer: Sequence[int] = LONGER,
) -> Iterator[OperatingPoint]:
    """All thresholds and durations at one place of the logit."""
    fold_of = [None if one is None else moved(one, nats or 0.0) for one in held]
    slips = [(k, one) for k, one in enumerate(others) if one.recording.events]
    answers = [
        corrected(one, fold_of[k % FOLDS], weights) for k, one in enumerate(person)
    ]
    answers += [corrected(one, fold_of[k % FOLDS], weights) for k, one in slips]
    streams = [*person, *(one for _, one in slips)]
    for more in longer:
        rules = replace(base, act_samples=base.act_samples + more)
        requests = act_requests(answers, rules, permille)
        for k, least in enumerate(permille):
            on = [one[:, k] for one in requests]
            reached = _reached(
                streams, on, _called(answers[: len(person)], rules, least)
            )
            yield OperatingPoint(
                nats, replace(rules, min_risky_permille=least), reached
            )


def _called(answers: Sequence[Answers], rules: DecisionRules, permille: int) -> int:
    """Samples that are risky, and others beside them, for as long as an act needs."""
    needed, total = np.ones(rules.act_samples), 0
    for one in answers:
        lasting = np.convolve(_risky(one, permille), needed, "valid") >= len(needed)
        total += int((np.convolve(lasting, needed) > 0).sum())
    return total


def _risky(one: Answers, permille: int) -> BoolArray:
    return np.asarray((one.situation == RISKY_SLIP) & (one.risky_permille >= permille))


def _reached(
    streams: Sequence[Stream], requests: Sequence[BoolArray], samples: int
) -> Reached:
    """streams: the person's, then the others'; those without slips have hand-overs."""
    pairs = list(zip(streams, requests, strict=True))
    outcomes = [o for s, on in pairs for o in match_alarms(s.recording, on).outcomes]
    acted = [o for o in outcomes if o.alarm_s is not None]
    before = [o for o in acted if o.lead_s is not None and o.lead_s > 0.0]
    called = [
        bool(on[action.first : action.stop].any())
        for s, on in pairs
        if not s.recording.events
        for action in voluntary_actions(s.recording)
    ]
    return Reached(
        recall=len(acted) / max(1, len(outcomes)),
        before_gross_slip=len(before) / max(1, len(outcomes)),
        hand_overs=len(called),
        called=sum(called),
        called_samples=samples,
    )
