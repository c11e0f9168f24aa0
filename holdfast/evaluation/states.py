"""The states of the model on whole streams: delay, stability, calibration and confusion.

Everything counts samples of labelled phases, in natural proportion. A state is the answer to a
single sample, before the decision's debounce and hold.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import RISKY_SLIP, SITUATIONS, BoolArray
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.event_scores import EventMatch, event_scores, match_alarms
from holdfast.evaluation.methods import without_samples
from holdfast.evaluation.model_outputs import NO_CLASS, ModelOutputs
from holdfast.evaluation.scores import LEVELS, labels_at
from holdfast.evaluation.statistics import Spread, share
from holdfast.evaluation.truths import voluntary_actions
from holdfast.training.figures import Interval, Share
from holdfast.training.metrics import Labels, situation_scores
from holdfast.training.timeline import Phase

BINS = 15


@dataclass(frozen=True)
class CalibrationBin:
    """n samples in a bin. said: mean predicted probability. was: share that came true."""

    n: int
    said: float
    was: float


@dataclass(frozen=True)
class CalibrationFigures:
    """Expected calibration error of the most probable situation, and of risky_slip alone."""

    n: int
    bins: int
    ece: float
    ece_risky: float
    reliability_risky: list[CalibrationBin]


@dataclass(frozen=True)
class ConfusionFigures:
    """counts: truth (rows) by answer (columns, the last unknown); F1 with intervals over groups."""

    classes: tuple[str, ...]
    counts: list[list[int]]
    macro_f1: float | None
    macro_f1_ci: Interval | None
    f1: dict[str, float | None]
    f1_ci: dict[str, Interval | None]


@dataclass(frozen=True)
class StateFigures:
    """Everything a report shows of the states. confusion: by level (four, seven, eight)."""

    per: str
    to_risky_state_ms: Spread | None
    risky_state_recall: float | None
    safe_acts_state_called: Share
    unknown_share: float | None
    changes_per_s: float | None
    true_changes_per_s: float | None
    calibration: CalibrationFigures | None
    confusion: dict[str, ConfusionFigures]


def risky_states(outputs: Sequence[ModelOutputs], permille: int) -> list[EventMatch]:
    """The state itself as an alarm: risky_slip with this confidence, without debounce or hold."""
    return [
        match_alarms(
            without_samples(one.recording),
            (one.situation == RISKY_SLIP) & (one.risky_permille >= permille),
        )
        for one in outputs
    ]


def state_figures(
    outputs: Sequence[ModelOutputs],
    permille: int,
    heavy: Sequence[bool | None],
    seed: int,
) -> StateFigures:
    """All figures of the states. heavy: of each recording's object; None where it is not known."""
    delay = event_scores(risky_states(outputs, permille), seed=seed)
    labels = [
        labels_everywhere(one.recording.phases, len(one.situation)) for one in outputs
    ]
    return StateFigures(
        per="sample of a labelled phase",
        to_risky_state_ms=delay.delay_ms,
        risky_state_recall=delay.recall,
        safe_acts_state_called=share(
            [hit for one in outputs for hit in _actions_called(one)]
        ),
        unknown_share=_mean([one.situation == UNKNOWN for one in outputs]),
        changes_per_s=changes_per_s([one.situation for one in outputs], outputs),
        true_changes_per_s=changes_per_s(labels, outputs),
        calibration=calibration(outputs, labels),
        confusion=confusions(outputs, labels, heavy, seed),
    )


def labels_everywhere(phases: Sequence[Phase], n: int) -> npt.NDArray[np.int64]:
    """[T] the situation of every sample, UNKNOWN in no phase."""
    label = np.full(n, UNKNOWN)
    for phase in phases:
        label[phase.first : phase.stop] = phase.situation
    return label


def _actions_called(of: ModelOutputs) -> list[bool]:
    actions = voluntary_actions(of.recording)
    return [
        bool((of.situation[one.first : one.stop] == RISKY_SLIP).any())
        for one in actions
    ]


def _mean(flags: Sequence[BoolArray]) -> float | None:
    return float(np.concatenate(flags).mean()) if flags else None


def changes_per_s(
    states: Sequence[npt.NDArray[np.int64]], outputs: Sequence[ModelOutputs]
) -> float | None:
    """Changes a second from one known state to another."""
    changes, seconds = 0, 0.0
    for state, one in zip(states, outputs, strict=True):
        known = state[state != UNKNOWN]
        changes += int((np.diff(known) != 0).sum())
        seconds += len(known) / one.recording.rate_hz
    return changes / seconds if seconds else None


def calibration(
    outputs: Sequence[ModelOutputs], labels: Sequence[npt.NDArray[np.int64]]
) -> CalibrationFigures | None:
    """Calibration in BINS equal bins; None without a sample that has an answer and a label.

    Guo et al., ICML 2017: sum over bins of their share of the samples times |mean probability -
    share that came true|.
    """
    pairs = list(zip(outputs, labels, strict=True))
    here = [(one.situation != UNKNOWN) & (label != UNKNOWN) for one, label in pairs]
    chosen = [
        (one.p_situation[at], label[at])
        for (one, label), at in zip(pairs, here, strict=True)
    ]
    p = np.concatenate([p for p, _ in chosen] or [np.zeros((0, 4))])
    label = np.concatenate([label for _, label in chosen] or [np.zeros(0, np.int64)])
    if not len(p):
        return None
    top = _bins(p.max(axis=1), p.argmax(axis=1) == label)
    risky = _bins(p[:, RISKY_SLIP], label == RISKY_SLIP)
    return CalibrationFigures(len(p), BINS, _ece(top), _ece(risky), risky)


def _bins(probability: npt.NDArray[Any], true: BoolArray) -> list[CalibrationBin]:
    place = np.minimum((BINS * probability).astype(np.int64), BINS - 1)
    counts = np.bincount(place, minlength=BINS)
    said, was = (
        np.bincount(place, weights=w, minlength=BINS) for w in (probability, true)
    )
    full = zip(counts.tolist(), said.tolist(), was.tolist(), strict=True)
    return [CalibrationBin(n, s / n, w / n) for n, s, w in full if n]


def _ece(bins: list[CalibrationBin]) -> float:
    total = sum(one.n for one in bins)
    return sum(one.n / total * abs(one.said - one.was) for one in bins)


def confusions(
    outputs: Sequence[ModelOutputs],
    labels: Sequence[npt.NDArray[np.int64]],
    heavy: Sequence[bool | None],
    seed: int,
) -> dict[str, ConfusionFigures]:
    """Level -> confusion.

    Eight and seven classes need a model that votes for eight, and a known weight.
    """
    groups = [one.recording.group for one in outputs]
    figures = {
        "four": _confusion(
            SITUATIONS, labels, [one.situation for one in outputs], groups, seed
        )
    }
    weighed = [
        k
        for k, one in enumerate(outputs)
        if heavy[k] is not None and (one.eight != NO_CLASS).any()
    ]
    if not weighed:
        return figures
    eight = [_with_weight(labels[k], bool(heavy[k])) for k in weighed]
    seven = [
        np.where(label == UNKNOWN, UNKNOWN, labels_at(label, "seven"))
        for label in eight
    ]
    groups = [groups[k] for k in weighed]
    for level, truth in (("eight", eight), ("seven", seven)):
        answers = [getattr(outputs[k], level) for k in weighed]
        figures[level] = _confusion(LEVELS[level], truth, answers, groups, seed)
    return figures


def _confusion(
    classes: tuple[str, ...],
    truth: Sequence[Labels],
    answer: Sequence[Labels],
    group: Sequence[str],
    seed: int,
) -> ConfusionFigures:
    """truth, answer: [T] of each recording.

    Samples without a label (below 0) are left out; withheld answers count.
    """
    n = len(classes)
    labelled = [label >= 0 for label in truth]
    was = np.concatenate([label[at] for label, at in zip(truth, labelled, strict=True)])
    answered = np.concatenate(
        [label[at] for label, at in zip(answer, labelled, strict=True)]
    )
    answered = np.where(answered < 0, n, answered)
    matrix = np.bincount((n + 1) * was + answered, minlength=n * (n + 1)).reshape(
        n, n + 1
    )
    groups = np.repeat(group, [int(at.sum()) for at in labelled])
    scores = situation_scores(was, answered, groups, classes=classes, seed=seed)
    return ConfusionFigures(
        (*classes, "unknown"),
        matrix.tolist(),
        scores.macro_f1,
        scores.macro_f1_ci,
        scores.f1,
        scores.f1_ci,
    )


def _with_weight(
    situation: npt.NDArray[np.int64], heavy: bool
) -> npt.NDArray[np.int64]:
    return np.where(situation == UNKNOWN, UNKNOWN, 2 * situation + int(heavy))
