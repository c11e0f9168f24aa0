"""What each method requested on whole streams, and its row of figures.

A method is this model at some confidence, or a baseline. Events and false alarms have bootstrap
intervals over trials (or people), and over styles where there are several.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, fields, replace
from typing import Any

import numpy as np

from holdfast.core.contract import BoolArray
from holdfast.core.trial_layout import VOLUNTARY_ACTIONS
from holdfast.data.datasets.trials import by_kind
from holdfast.data.metrics import Interval, Share
from holdfast.evaluation.alarms import (
    WIDE_COLLAR_S,
    AlarmRates,
    EventMatch,
    EventScores,
    event_scores,
    match_alarms,
)
from holdfast.evaluation.formats import share
from holdfast.evaluation.trials import DISTURBANCES, LabelledTrial, voluntary_actions


@dataclass(frozen=True)
class TrialOutcome:
    """What one method requested in a trial.

    match, wide: its alarms at the usual and at the wider collar. called: of each voluntary action,
    whether an act was requested at any sample of it. quiet: no act was requested at all.
    """

    trial: LabelledTrial
    match: EventMatch
    wide: EventMatch
    called: tuple[bool, ...]
    quiet: bool


Outcomes = Sequence[TrialOutcome]


def outcomes_of(
    trials: Sequence[LabelledTrial], requests: Sequence[BoolArray]
) -> list[TrialOutcome]:
    """Match the requests [T] in each trial with its truth."""
    outcomes = []
    for trial, on in zip(trials, requests, strict=True):
        recording = trial.recording
        called = []
        for action in voluntary_actions(recording):
            # A single sample counts: one request tightens the hand against its wearer.
            called.append(bool(on[action.first : action.stop].any()))
        outcomes.append(
            TrialOutcome(
                trial,
                match_alarms(recording, on),
                # The truth is no sharper than the collar: the difference shows its influence.
                wide=match_alarms(recording, on, WIDE_COLLAR_S),
                called=tuple(called),
                quiet=not bool(on.any()),
            )
        )
    return outcomes


def detected(outcomes: Outcomes) -> BoolArray:
    """[E] whether each event was detected."""
    found = []
    for one in outcomes:
        for event in one.match.outcomes:
            found.append(event.alarm_s is not None)
    return np.array(found, dtype=np.bool_)


@dataclass(frozen=True)
class CollarFigures(AlarmRates):
    """The figures that a wider collar changes."""

    already_on: int
    false_alarms: int


@dataclass(frozen=True)
class StyleFigures(AlarmRates):
    """One style; its intervals are over its trials."""

    events: int
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
    methods: Mapping[str, Outcomes], seed: int
) -> dict[str, MethodFigures]:
    """All figures of every method."""
    figures = {}
    for name, of in methods.items():
        # Every method gets the same seed, so that all draw the same groups.
        figures[name] = method_figures(of, seed)
    return figures


def method_figures(of: Outcomes, seed: int) -> MethodFigures:
    """All figures of a method."""
    # The same seed for both collars, so that they draw the same groups.
    scores = event_scores([one.match for one in of], seed=seed)
    wide = event_scores([one.wide for one in of], seed=seed)
    by_action = {}
    called_by_action = {}
    # By name, so that the order does not depend on which trial came first.
    for name, each in sorted(by_kind(of, _action).items()):
        called = _called(each)
        if called.n:
            called_by_action[name] = called
        # A recording of several grasps has no one action.
        if name:
            by_action[name] = _kind(each)

    return MethodFigures(
        **vars(scores),
        # The name is a key of the file format; its width is WIDE_COLLAR_S.
        collar_40_ms=CollarFigures(**_shared(wide, CollarFigures)),
        by_style=by_style(of, seed),
        safe_acts_called=_called(of),
        safe_acts_by_action=called_by_action,
        with_enough_time=_kind(of),
        by_action=by_action,
        specificity=specificity(of),
    )


def _shared(scores: EventScores, other: type) -> dict[str, Any]:
    """The scores that another dataclass has too, by name."""
    shared = {}
    for one in fields(other):
        if one.name in vars(scores):
            shared[one.name] = vars(scores)[one.name]
    return shared


def _action(of: TrialOutcome) -> str:
    return of.trial.recording.action or ""


def _called(of: Outcomes) -> Share:
    called: list[bool] = []
    for one in of:
        called += one.called
    return share(called)


def _kind(of: Outcomes) -> KindFigures:
    in_time = []
    false_alarms = 0
    minutes = 0.0
    for one in of:
        false_alarms += len(one.match.false_s)
        minutes += one.match.minutes
        for outcome in one.match.outcomes:
            available_s = outcome.available_s
            if available_s is not None and available_s >= ENOUGH_S:
                lead_s = outcome.lead_s
                in_time.append(lead_s is not None and lead_s > 0.0)
    return KindFigures(
        recall=share(detected(of).tolist()),
        in_time=share(in_time),
        false_alarms=false_alarms,
        minutes=minutes,
    )


def by_style(of: Outcomes, seed: int) -> ByStyle | None:
    """Recall and false alarms by style, and intervals over styles; None with less than two."""
    styles = dict(sorted(by_kind(of, lambda one: one.trial.style).items()))
    # Trials of several people, or of none that is named.
    styles.pop("", None)
    # Of one style there is no spread between people to show.
    if len(styles) < 2:
        return None

    figures = {}
    grouped = []
    for name, trials in styles.items():
        matches = [one.match for one in trials]
        scores = event_scores(matches, seed=seed)
        called = _called(trials)
        shared = _shared(scores, StyleFigures)
        figures[name] = StyleFigures(**shared, safe_acts_called=called)
        for match in matches:
            # The bootstrap draws groups, so the style takes the place of the person.
            as_group = replace(match.recording, group=name)
            grouped.append(replace(match, recording=as_group))

    # With the styles as groups, the interval says how far another person may be off.
    whole = event_scores(grouped, seed=seed)
    return ByStyle(whole.recall_ci, whole.false_per_min_ci, figures)


def specificity(of: Outcomes) -> dict[str, HoldFigures] | None:
    """Disturbance -> the holds that were disturbed by it; None without any."""
    figures = {}
    # Every disturbance has a row, also one that no hold of the set had.
    for name in DISTURBANCES:
        quiet = []
        failed = 0
        for one in of:
            n_holds = one.trial.disturbances.count(name)
            # A hold that was disturbed too much ends as an event: it deserved its alarm.
            if one.match.outcomes:
                failed += n_holds
            else:
                quiet += [one.quiet] * n_holds
        of_quiet = share(quiet)
        figures[name] = HoldFigures(**vars(of_quiet), failed=failed)

    any_hold = any(one.n + one.failed for one in figures.values())
    return figures if any_hold else None
