"""When an adaptation acts: the operating point, chosen on trials that its correction has not seen.

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
from holdfast.evaluation.alarms import Answers, act_requests, match_alarms
from holdfast.evaluation.trials import voluntary_actions
from holdfast.export.heads import Correction
from holdfast.sessions.adapt_evidence import (
    LabelWeights,
    Stream,
    corrected,
    fit_correction,
    moved,
)

LEAST_RECALL = 0.99
"""Of the others' slips, with the trial held out; or the base's own recall where that is less."""
MOST_RECALL_LOST = 0.01 + 1e-9
"""More makes a file that is worse than its base; a hair more, for 1 - 0.99 in binary."""
FOLDS = 4
"""Parts of all trials; each is answered by a correction fitted without it."""
NATS = (-1.0, -0.5, 0.0, 0.5, 1.0, 1.5, 2.0, 3.0, 4.0)
"""How far the logit of a correction is moved."""
PERMILLE = (400, 500, 600, 700)
FINER = tuple(range(400, 1000, 50))
"""Thresholds with a correction, whose place moves more finely, and without one."""
LONGER = (0, 1)
"""Samples that an act needs beyond the base's."""
NO_CORRECTION: tuple[None, ...] = (None,) * FOLDS


@dataclass(frozen=True)
class HeldOutFigures:
    """What an operating point reaches on held-out trials.

    recall, before_gross_slip: of all slips, the others' and the person's. slips, found: of the
    person alone. hand_overs, called: of the person's voluntary actions, put-downs too.
    called_samples: of the person, at which an act may begin.
    """

    recall: float
    before_gross_slip: float
    slips: int
    found: int
    hand_overs: int
    called: int
    called_samples: int

    def worse_than(self, base: HeldOutFigures) -> list[str]:
        """In which ways these figures are worse than the base's on the same trials; empty: none."""
        worse = []
        if self.recall < base.recall - MOST_RECALL_LOST:
            worse.append(f"recall {self.recall:.3f}, of the base {base.recall:.3f}")
        if self.found < base.found - MOST_RECALL_LOST * base.slips:
            counts = f"{self.found} of {self.slips} found, by the base {base.found}"
            worse.append(f"slips of the person: {counts}")
        if self.called > base.called:
            counts = f"{self.called} of {self.hand_overs}, by the base {base.called}"
            worse.append(f"voluntary actions called: {counts}")
        return worse


@dataclass(frozen=True)
class OperatingPoint:
    """nats: how far the correction's logit is moved, None without a correction."""

    nats: float | None
    rules: DecisionRules
    reached: HeldOutFigures


@dataclass(frozen=True)
class Evidence:
    """A person's trials and those of other slips; rules, weights and votes of the base."""

    person: Sequence[Stream]
    others: Sequence[Stream]
    rules: DecisionRules
    weights: LabelWeights
    votes_in_all: int

    def choose(self, *, threshold_only: bool = False) -> OperatingPoint:
        """The operating point. threshold_only: the decision's parameters without a correction."""
        points: list[OperatingPoint] = []
        if threshold_only:
            points += self._points(NO_CORRECTION, None, FINER)
        else:
            fits = [self._fitted_without(fold) for fold in range(FOLDS)]
            for nats in NATS:
                corrections = [moved(fit, nats) for fit in fits]
                points += self._points(corrections, nats, PERMILLE)

        # The base itself sets the recall to keep.
        least = min(LEAST_RECALL, self.base_figures().recall)
        enough = [point for point in points if point.reached.recall >= least]
        # No point may keep the recall where the person's hand-overs look like slips.
        if not enough:
            return max(points, key=lambda point: point.reached.recall)
        return min(enough, key=_cost)

    def base_figures(self) -> HeldOutFigures:
        """What the base reaches on the same trials; it has seen none of them."""
        own = (self.rules.min_risky_permille,)
        (point,) = self._points(NO_CORRECTION, None, own, (0,))
        return point.reached

    def correction(self, point: OperatingPoint) -> Correction | None:
        """The correction of an operating point, fitted on all trials; None without one."""
        if point.nats is None:
            return None
        fitted = fit_correction(self.person, self.others, self.votes_in_all)
        return moved(fitted, point.nats)

    def _fitted_without(self, fold: int) -> Correction:
        """A trial of the others must not judge a correction that has seen it either."""
        seen = [one for k, one in enumerate(self.person) if k % FOLDS != fold]
        seen_others = [one for k, one in enumerate(self.others) if k % FOLDS != fold]
        return fit_correction(seen, seen_others, self.votes_in_all)

    def _points(
        self,
        corrections: Sequence[Correction | None],
        nats: float | None,
        permille: Sequence[int],
        longer: Sequence[int] = LONGER,
    ) -> Iterator[OperatingPoint]:
        """All thresholds and durations; corrections: for the trials of each fold."""
        # The person's trials come first, so that their samples can be counted alone.
        answers = self._answers(self.person, corrections)
        of_person = len(answers)
        for one in self._answers(self.others, corrections):
            if one.recording.events:
                answers.append(one)

        for more in longer:
            # A threshold that is lower may need a run that is longer.
            rules = replace(self.rules, act_samples=self.rules.act_samples + more)
            # All thresholds of one duration in one pass: the decision is stepped once for all of
            # them.
            requests = act_requests(answers, rules, permille)
            for k, least in enumerate(permille):
                samples = _called_samples(answers[:of_person], rules, least)
                reached = _reached(
                    answers, [on[:, k] for on in requests], samples, of_person
                )
                at_least = replace(rules, min_risky_permille=least)
                yield OperatingPoint(nats, at_least, reached)

    def _answers(
        self, streams: Sequence[Stream], corrections: Sequence[Correction | None]
    ) -> list[Answers]:
        """Each trial's, by the correction that has not seen it."""
        answers = []
        for k, stream in enumerate(streams):
            answers.append(corrected(stream, corrections[k % FOLDS], self.weights))
        return answers


def _cost(point: OperatingPoint) -> tuple[float, ...]:
    reached = point.reached
    return reached.called_samples, -reached.before_gross_slip, -reached.recall


def _called_samples(
    answers: Sequence[Answers], rules: DecisionRules, permille: int
) -> int:
    """Samples that are risky, together with others, for as long as an act needs."""
    needed = np.ones(rules.act_samples)
    total = 0
    for one in answers:
        risky = (one.situation == RISKY_SLIP) & (one.risky_permille >= permille)
        # A run shorter than an act needs calls nothing, and does not count.
        lasting = np.convolve(risky, needed, "valid") >= len(needed)
        # The second convolution gives back all samples of every run that lasts.
        total += int((np.convolve(lasting, needed) > 0).sum())
    return total


def _reached(
    answers: Sequence[Answers],
    requests: Sequence[BoolArray],
    called_samples: int,
    of_person: int,
) -> HeldOutFigures:
    """Figures of slips, and of hand-overs in trials without one.

    of_person: how many answers, from the first, are the person's.
    """
    acted: list[bool] = []
    before: list[bool] = []
    called: list[bool] = []
    n_own = 0
    for k, (one, on) in enumerate(zip(answers, requests, strict=True)):
        for outcome in match_alarms(one.recording, on).outcomes:
            acted.append(outcome.alarm_s is not None)
            in_time = outcome.lead_s is not None and outcome.lead_s > 0.0
            before.append(acted[-1] and in_time)
        if k < of_person:
            n_own = len(acted)
        # In a trial with a slip an act request may be right, so its hand-overs do not count.
        if not one.recording.events:
            for action in voluntary_actions(one.recording):
                called.append(bool(on[action.first : action.stop].any()))

    return HeldOutFigures(
        recall=sum(acted) / max(1, len(acted)),
        before_gross_slip=sum(before) / max(1, len(before)),
        slips=n_own,
        found=sum(acted[:n_own]),
        hand_overs=len(called),
        called=sum(called),
        called_samples=called_samples,
    )
