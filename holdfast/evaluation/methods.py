"""What each method requested on whole streams, and its row of figures.

A method is this model at some confidence, or a baseline. Events and false alarms have bootstrap
intervals over trials (or people), and over styles where there are several.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np

from holdfast.core.contract import BoolArray
from holdfast.core.trial_layout import VOLUNTARY_ACTIONS
from holdfast.evaluation.alarms import (
    WIDE_COLLAR_S,
    EventMatch,
    EventScores,
    event_scores,
    match_alarms,
)
from holdfast.evaluation.statistics import share
from holdfast.evaluation.trials import (
    DISTURBANCES,
    LabelledTrial,
    style_of,
    voluntary_actions,
)
from holdfast.training.figures import Interval, Share


class CalledAction(NamedTuple):
    """A voluntary action, and whether an act was requested at any sample of it."""

    style: str
    action: str
    called: bool


class DisturbedHold(NamedTuple):
    """A disturbed hold: whether the grip held to the end, and whether there was no alarm at all."""

    disturbance: str
    held: bool
    quiet: bool


@dataclass
class MethodResult:
    """What one method requested in each recording.

    matches: its alarms at the usual collar. wide: at the wider collar.
    """

    matches: list[EventMatch] = field(default_factory=list)
    wide: list[EventMatch] = field(default_factory=list)
    actions: list[CalledAction] = field(default_factory=list)
    holds: list[DisturbedHold] = field(default_factory=list)

    def detected(self) -> BoolArray:
        """[E] whether each event was detected."""
        found = []
        for match in self.matches:
            found += [outcome.alarm_s is not None for outcome in match.outcomes]
        return np.array(found, dtype=np.bool_)


def method_result(
    trials: Sequence[LabelledTrial], requests: Sequence[BoolArray]
) -> MethodResult:
    """Match the requests [T] in each trial with its truth."""
    result = MethodResult()
    for trial, on in zip(trials, requests, strict=True):
        recording = trial.recording
        result.matches.append(match_alarms(recording, on))
        # Twice, since the truth is no sharper than the collar: the difference shows its influence.
        result.wide.append(match_alarms(recording, on, WIDE_COLLAR_S))

        style = style_of(trial.grasps)
        for action in voluntary_actions(recording):
            # A single sample counts: one request tightens the hand against its wearer.
            called = bool(on[action.first : action.stop].any())
            result.actions.append(CalledAction(style, recording.action or "", called))

        for grasp in trial.grasps:
            if grasp.disturbance:
                # A hold that was disturbed too much ends as an event: the object slipped.
                held = not recording.events
                # Anywhere in the recording: without an action every request is one too many.
                quiet = not bool(on.any())
                result.holds.append(DisturbedHold(grasp.disturbance, held, quiet))

    return result


def together(results: Sequence[MethodResult]) -> MethodResult:
    """One method on several sets as on one."""
    whole = MethodResult()
    for result in results:
        # One after another: every recording keeps its own events, minutes and group.
        whole.matches += result.matches
        whole.wide += result.wide
        whole.actions += result.actions
        whole.holds += result.holds
    return whole


@dataclass(frozen=True)
class CollarFigures:
    """The figures that a wider collar changes."""

    recall: float | None
    recall_ci: Interval | None
    false_per_min: float | None
    false_per_min_ci: Interval | None
    already_on: int
    false_alarms: int


@dataclass(frozen=True)
class StyleFigures:
    """One style; its intervals are over its trials."""

    events: int
    recall: float | None
    recall_ci: Interval | None
    false_per_min: float | None
    false_per_min_ci: Interval | None
    minutes: float
    safe_acts_called: Share


@dataclass(frozen=True)
class ByStyle:
    """Intervals over styles, and each style."""

    recall_ci: Interval | None
    false_per_min_ci: Interval | None
    styles: dict[str, StyleFigures]


@dataclass(frozen=True)
class HoldFigures(Share):
    """Share of the holds that held which brought no alarm. failed: those that did not hold."""

    failed: int


ENOUGH_S = 0.015
"""A slip with this much time from load onset to gross slip can be acted on before it."""


@dataclass(frozen=True)
class KindFigures:
    """One action, or all of them.

    recall        of its events
    in_time       acted on before gross slip, of the events with ENOUGH_S and more
    false_alarms  in its recordings
    minutes       of its recordings
    """

    recall: Share
    in_time: Share
    false_alarms: int
    minutes: float


@dataclass(frozen=True)
class MethodFigures(EventScores):
    """Everything a table shows of a method. safe_acts_..: those that were called risky.

    with_enough_time: of all actions together; by_action: of each action by itself.
    """

    collar_40_ms: CollarFigures
    by_style: ByStyle | None
    safe_acts_called: Share
    safe_acts_by_action: dict[str, Share]
    with_enough_time: KindFigures
    by_action: dict[str, KindFigures]
    specificity: dict[str, HoldFigures] | None

    @property
    def safe_acts(self) -> str:
        """What the safe slips are: voluntary actions where each is known to be one."""
        meant = set(self.safe_acts_by_action) <= set(VOLUNTARY_ACTIONS)
        return "voluntary actions" if meant else "safe slips"


def figures_of_methods(
    methods: Mapping[str, MethodResult],
    trials: Sequence[LabelledTrial],
    seed: int,
) -> dict[str, MethodFigures]:
    """All figures of every method."""
    figures = {}
    for name, result in methods.items():
        # Every method gets the same seed, so that all draw the same groups.
        figures[name] = method_figures(result, trials, seed)

    return figures


def method_figures(
    of: MethodResult,
    trials: Sequence[LabelledTrial],
    seed: int,
) -> MethodFigures:
    """All figures of a method."""
    # The same seed for both collars, so that they draw the same groups.
    scores = event_scores(of.matches, seed=seed)
    wide = event_scores(of.wide, seed=seed)
    collar = CollarFigures(
        recall=wide.recall,
        recall_ci=wide.recall_ci,
        false_per_min=wide.false_per_min,
        false_per_min_ci=wide.false_per_min_ci,
        already_on=wide.already_on,
        false_alarms=wide.false_alarms,
    )

    return MethodFigures(
        **vars(scores),
        # The name is a key of the file format; its width is WIDE_COLLAR_S.
        collar_40_ms=collar,
        by_style=by_style(of, trials, seed),
        safe_acts_called=_called(of.actions),
        safe_acts_by_action=_called_by_action(of.actions),
        with_enough_time=_kind(of.matches),
        by_action=_by_action(of.matches),
        specificity=specificity(of.holds),
    )


def _called(actions: Sequence[CalledAction]) -> Share:
    return share([one.called for one in actions])


def _called_by_action(actions: Sequence[CalledAction]) -> dict[str, Share]:
    by_action: dict[str, list[CalledAction]] = {}
    for one in actions:
        by_action.setdefault(one.action, []).append(one)
    return {name: _called(by_action[name]) for name in sorted(by_action)}


def _by_action(matches: Sequence[EventMatch]) -> dict[str, KindFigures]:
    of_each: dict[str, list[EventMatch]] = {}
    for match in matches:
        # A recording of several grasps has no one action.
        if match.recording.action:
            of_each.setdefault(match.recording.action, []).append(match)
    return {name: _kind(of_each[name]) for name in sorted(of_each)}


def _kind(matches: Sequence[EventMatch]) -> KindFigures:
    found = []
    in_time = []
    for match in matches:
        for outcome in match.outcomes:
            found.append(outcome.alarm_s is not None)
            available_s = outcome.available_s
            if available_s is not None and available_s >= ENOUGH_S:
                lead_s = outcome.lead_s
                in_time.append(lead_s is not None and lead_s > 0.0)
    return KindFigures(
        recall=share(found),
        in_time=share(in_time),
        false_alarms=sum(len(match.false_s) for match in matches),
        minutes=sum(match.minutes for match in matches),
    )


def by_style(
    of: MethodResult, trials: Sequence[LabelledTrial], seed: int
) -> ByStyle | None:
    """Recall and false alarms by style, and intervals over styles; None with less than two."""
    matches: dict[str, list[EventMatch]] = {}
    grouped = []
    for trial, match in zip(trials, of.matches, strict=True):
        style = style_of(trial.grasps)
        if style:
            matches.setdefault(style, []).append(match)
            # The bootstrap draws groups, so the style takes the place of the person.
            as_group = replace(match.recording, group=style)
            grouped.append(replace(match, recording=as_group))

    # Of one style there is no spread between people to show.
    if len(matches) < 2:
        return None

    figures = {}
    # By name, so that the order does not depend on which trial came first.
    for name in sorted(matches):
        scores = event_scores(matches[name], seed=seed)
        actions = [one for one in of.actions if one.style == name]
        figures[name] = StyleFigures(
            events=scores.events,
            recall=scores.recall,
            recall_ci=scores.recall_ci,
            false_per_min=scores.false_per_min,
            false_per_min_ci=scores.false_per_min_ci,
            minutes=scores.minutes,
            safe_acts_called=_called(actions),
        )

    # With the styles as groups, the interval says how far another person may be off.
    whole = event_scores(grouped, seed=seed)
    return ByStyle(whole.recall_ci, whole.false_per_min_ci, figures)


def specificity(holds: Sequence[DisturbedHold]) -> dict[str, HoldFigures] | None:
    """Disturbance -> the holds that were disturbed by it; None without any."""
    if not holds:
        return None
    # Every disturbance has a row, also one that no hold of the set had.
    figures = {}
    for name in DISTURBANCES:
        here = [one for one in holds if one.disturbance == name]
        # A hold that failed deserved its alarm, so only those that held can be quiet.
        quiet = share([one.quiet for one in here if one.held])
        failed = sum(not one.held for one in here)
        figures[name] = HoldFigures(quiet.share, quiet.share_ci, quiet.n, failed)

    return figures
