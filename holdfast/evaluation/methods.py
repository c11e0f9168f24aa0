"""What each method requested on whole streams, and its row of figures.

A method is this model at some confidence, or a baseline. Events and false alarms have bootstrap
intervals over trials (or people), and over styles where there are several.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any, NamedTuple

import numpy as np

from holdfast.core.contract import BoolArray
from holdfast.evaluation.camera import CameraFigures, SeenSlip, camera_figures
from holdfast.evaluation.closing_hand import Droppable, KeptObjects
from holdfast.evaluation.event_scores import (
    COLLAR_S,
    COLLARS_S,
    EventMatch,
    EventScores,
    event_scores,
    match_alarms,
)
from holdfast.evaluation.statistics import share
from holdfast.evaluation.truths import DISTURBANCES, Grasp, style_of, voluntary_actions
from holdfast.training.figures import Interval, Share
from holdfast.training.recording import Recording


@dataclass(frozen=True)
class LabelledTrial:
    """One recording without its samples, its grasps by the truth, and what a camera saw of it."""

    recording: Recording
    grasps: tuple[Grasp, ...]
    seen: tuple[SeenSlip, ...] = ()


def without_samples(recording: Recording) -> Recording:
    """The same recording, as light as its labels."""
    return replace(recording, samples=recording.samples[:0], valid=recording.valid[:0])


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


@dataclass(frozen=True)
class MethodResult:
    """What one method requested in each recording. by_collar: collar in s -> streams."""

    by_collar: dict[float, list[EventMatch]]
    actions: list[CalledAction]
    holds: list[DisturbedHold]

    @property
    def matches(self) -> list[EventMatch]:
        """At the narrower collar, which every figure without a collar of its own uses."""
        return self.by_collar[COLLAR_S]

    def detected(self) -> BoolArray:
        """[E] whether each event was detected."""
        return np.array(
            [delay_s is not None for delay_s in self.delays_s()], dtype=np.bool_
        )

    def delays_s(self) -> list[float | None]:
        """[E] s from load onset to the alarm; None where there was none."""
        return [o.delay_s for one in self.matches for o in one.outcomes]


def method_result(
    trials: Sequence[LabelledTrial], requests: Sequence[BoolArray]
) -> MethodResult:
    """Match the requests [T] in each trial with its truth."""
    pairs = list(zip(trials, requests, strict=True))
    return MethodResult(
        {
            collar: [match_alarms(trial.recording, on, collar) for trial, on in pairs]
            for collar in COLLARS_S
        },
        [action for trial, on in pairs for action in _actions(trial, on)],
        [hold for trial, on in pairs for hold in _holds(trial, on)],
    )


def _actions(trial: LabelledTrial, requests: BoolArray) -> list[CalledAction]:
    style, action = style_of(trial.grasps), trial.recording.action or ""
    return [
        CalledAction(style, action, bool(requests[one.first : one.stop].any()))
        for one in voluntary_actions(trial.recording)
    ]


def _holds(trial: LabelledTrial, requests: BoolArray) -> list[DisturbedHold]:
    held, quiet = not trial.recording.events, not bool(requests.any())
    kinds = [one.disturbance for one in trial.grasps if one.disturbance]
    return [DisturbedHold(kind, held, quiet) for kind in kinds]


def together(results: Sequence[MethodResult]) -> MethodResult:
    """One method on several sets as on one."""
    return MethodResult(
        {c: [one for part in results for one in part.by_collar[c]] for c in COLLARS_S},
        [action for part in results for action in part.actions],
        [hold for part in results for hold in part.holds],
    )


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


@dataclass(frozen=True)
class MethodFigures(EventScores):
    """Everything a table shows of a method. safe_acts: voluntary actions that were called risky."""

    collar_40_ms: CollarFigures
    by_style: ByStyle | None
    safe_acts_called: Share
    safe_acts_by_action: dict[str, Share]
    specificity: dict[str, HoldFigures] | None
    closing: KeptObjects | None
    camera: CameraFigures | None


def figures_of_methods(
    methods: Mapping[str, MethodResult],
    trials: Sequence[LabelledTrial],
    drops: Droppable | None,
    seed: int,
) -> dict[str, MethodFigures]:
    """All figures of every method. drops: None where no event can be modelled."""
    delays_s = [one.delays_s() for one in methods.values()]
    closing = [None] * len(methods) if drops is None else drops.kept_by_each(delays_s)
    return {
        name: method_figures(one, trials, kept, seed)
        for (name, one), kept in zip(methods.items(), closing, strict=True)
    }


def method_figures(
    of: MethodResult,
    trials: Sequence[LabelledTrial],
    closing: KeptObjects | None,
    seed: int,
) -> MethodFigures:
    """All figures of a method. closing: None where no event can be modelled."""
    wide = event_scores(of.by_collar[COLLARS_S[1]], seed=seed)
    actions = sorted({one.action for one in of.actions})
    return MethodFigures(
        **vars(event_scores(of.matches, seed=seed)),
        collar_40_ms=CollarFigures(**_fields(wide, CollarFigures)),
        by_style=by_style(of, trials, seed),
        safe_acts_called=share([one.called for one in of.actions]),
        safe_acts_by_action={
            name: share([one.called for one in of.actions if one.action == name])
            for name in actions
        },
        specificity=specificity(of.holds),
        closing=closing,
        camera=camera_figures(of.matches, [one.seen for one in trials]),
    )


def _fields(scores: EventScores, wanted: type) -> dict[str, Any]:
    """The fields of `wanted` that the scores have too."""
    return {
        name: getattr(scores, name)
        for name in vars(scores)
        if name in wanted.__annotations__
    }


def by_style(
    of: MethodResult, trials: Sequence[LabelledTrial], seed: int
) -> ByStyle | None:
    """Recall and false alarms by style, and intervals over styles; None with less than two."""
    styles = [style_of(one.grasps) for one in trials]
    names = sorted(set(styles) - {""})
    if len(names) < 2:
        return None
    known = [
        (style, one) for style, one in zip(styles, of.matches, strict=True) if style
    ]
    grouped = [
        replace(one, recording=replace(one.recording, group=style))
        for style, one in known
    ]
    whole = event_scores(grouped, seed=seed)
    figures = {}
    for name in names:
        scores = event_scores([one for style, one in known if style == name], seed=seed)
        called = share([one.called for one in of.actions if one.style == name])
        fields = _fields(scores, StyleFigures)
        figures[name] = StyleFigures(**fields, safe_acts_called=called)
    return ByStyle(whole.recall_ci, whole.false_per_min_ci, figures)


def specificity(holds: Sequence[DisturbedHold]) -> dict[str, HoldFigures] | None:
    """Disturbance -> the holds that were disturbed by it; None without any."""
    if not holds:
        return None
    figures = {}
    for name in DISTURBANCES:
        here = [one for one in holds if one.disturbance == name]
        quiet = share([one.quiet for one in here if one.held])
        figures[name] = HoldFigures(
            **vars(quiet), failed=sum(not one.held for one in here)
        )
    return figures
