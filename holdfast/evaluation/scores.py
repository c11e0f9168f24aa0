"""Scores of classes and situations, the share called risky, and a check that no weight leaks.

"Nothing, light" and "nothing, heavy" are the same signal. So the accuracy over eight balanced
classes is at most 6/8 + 2/8 x 1/2 = 0.875; a higher one shows that the label leaked. "Seven" counts
nothing once, with the votes of both added. Intervals are 95 %, over trials, unless stated.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    CLASSES,
    GRASP,
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
)
from holdfast.export.heads import riskier_argmax, situation_votes
from holdfast.export.network import IntArray
from holdfast.training.figures import Interval, Share
from holdfast.training.metrics import Labels, share_scores, situation_scores
from holdfast.training.recording import DataSet

LEVELS = {"eight": CLASSES, "seven": ("nothing", *CLASSES[2:]), "four": SITUATIONS}
CEILING = 0.875
LEAK_PERCENT = (0.5, 99.5)
LEAK_DRAWS = 4000
LEAK_EXPLAINED = (
    "Nothing held, light or heavy, is the same signal, so over eight balanced classes no honest "
    "answer exceeds 0.875, and within nothing the weight is right half of the time. Judged: the "
    "raw-window forest, trials held out, each window stepped from a fresh state (only its own N "
    "samples; the offset is the trial's unloaded start). A leak is a 99 % interval over trials "
    "that lies wholly above 0.875, or, sharper, above 0.5 for the weight within nothing."
)


@dataclass(frozen=True)
class LevelScores:
    """Accuracy and F1 at one level. present: number of classes that occur."""

    accuracy: float | None
    accuracy_ci: Interval | None
    macro_f1: float | None
    macro_f1_ci: Interval | None
    f1: dict[str, float | None]
    f1_ci: dict[str, Interval | None]
    present: int


@dataclass(frozen=True)
class RiskyCalls:
    """Share of the windows of each situation that are called risky; of risky, the recall."""

    risky: Share
    safe: Share
    grasp: Share
    nothing: Share


@dataclass(frozen=True)
class ClassScores:
    """Scores of votes for the eight classes, at every level."""

    n_windows: int
    n_trials: int
    eight: LevelScores
    seven: LevelScores
    four: LevelScores
    calls: RiskyCalls


@dataclass(frozen=True)
class LeakCheck:
    """Whether votes know the weight where no signal carries it. ci99: 99 % intervals."""

    leak: bool
    eight_class_accuracy: float | None
    eight_class_accuracy_ci99: Interval | None
    ceiling: float
    weight_within_nothing: float | None
    weight_within_nothing_ci99: Interval | None
    balanced: bool
    explanation: str


@dataclass(frozen=True)
class RecallSpread:
    """Recall of each class in every retraining, and its range; None for an absent class."""

    recall: dict[str, list[float] | None]
    spread: dict[str, float | None]
    largest_spread: float
    within_10_percent: bool


def labels_at(label: Labels, level: str) -> IntArray:
    """Labels 0..7 at a level: seven (0 and 1 are one) or four (light and heavy are one).

    >>> labels_at(np.arange(8), "seven").tolist(), labels_at(np.arange(8), "four").tolist()
    ([0, 0, 1, 2, 3, 4, 5, 6], [0, 0, 1, 1, 2, 2, 3, 3])
    """
    merged = {"eight": label, "seven": np.maximum(label - 1, 0), "four": label // 2}[
        level
    ]
    return np.asarray(merged, dtype=np.int64)


def answers_at(votes: IntArray, level: str) -> IntArray:
    """[M, 8] votes -> [M] answers at a level; votes of merged classes are added."""
    if level == "four":
        return riskier_argmax(situation_votes(votes))
    if level == "seven":
        votes = np.column_stack([votes[:, :2].sum(axis=1), votes[:, 2:]])
    return riskier_argmax(votes)


def scores(data: DataSet, votes: IntArray, *, seed: int = 0) -> ClassScores:
    """Accuracy and macro F1 at every level, and `calls`, of votes [M, 8] on "classes"."""
    label, groups = data.tasks["classes"].label, data.group_of("classes")
    levels = {
        level: _level_scores(
            labels_at(label, level), answers_at(votes, level), groups, level, seed
        )
        for level in LEVELS
    }
    called = calls(data, answers_at(votes, "four") == RISKY_SLIP, seed=seed)
    return ClassScores(len(label), len(np.unique(groups)), **levels, calls=called)


def _level_scores(
    truth: IntArray, answer: IntArray, groups: npt.ArrayLike, level: str, seed: int
) -> LevelScores:
    right = share_scores(truth == answer, groups, seed=seed)
    f1 = situation_scores(truth, answer, groups, classes=LEVELS[level], seed=seed)
    return LevelScores(
        accuracy=right.share,
        accuracy_ci=right.share_ci,
        macro_f1=f1.macro_f1,
        macro_f1_ci=f1.macro_f1_ci,
        f1=f1.f1,
        f1_ci=f1.f1_ci,
        present=len(np.unique(truth)),
    )


def calls(data: DataSet, called: BoolArray, *, seed: int = 0) -> RiskyCalls:
    """Shares of the windows that are called risky. called [M]: at each window of "classes"."""
    truth, groups = (
        labels_at(data.tasks["classes"].label, "four"),
        data.group_of("classes"),
    )
    situations = {
        "risky": RISKY_SLIP,
        "safe": SAFE_SLIP,
        "grasp": GRASP,
        "nothing": NOTHING,
    }
    shares = {
        name: share_scores(
            called[truth == situation], groups[truth == situation], seed=seed
        )
        for name, situation in situations.items()
    }
    return RiskyCalls(**shares)


def leak_check(data: DataSet, votes: IntArray, *, seed: int = 0) -> LeakCheck:
    """Whether votes [M, 8] of held-out trials know a weight that no signal carries.

    Classes must be balanced.
    """
    label, groups = data.tasks["classes"].label, data.group_of("classes")
    empty = labels_at(label, "four") == NOTHING
    right = riskier_argmax(votes) == label
    weight = riskier_argmax(votes[empty, :2]) == label[empty]
    whole, within = (
        share_scores(hit, of, percent=LEAK_PERCENT, n_draws=LEAK_DRAWS, seed=seed)
        for hit, of in ((right, groups), (weight, groups[empty]))
    )
    return LeakCheck(
        leak=_above(whole, CEILING) or _above(within, 0.5),
        eight_class_accuracy=whole.share,
        eight_class_accuracy_ci99=whole.share_ci,
        ceiling=CEILING,
        weight_within_nothing=within.share,
        weight_within_nothing_ci99=within.share_ci,
        balanced=len(np.unique(np.bincount(label, minlength=len(CLASSES)))) == 1,
        explanation=LEAK_EXPLAINED,
    )


def _above(figure: Share, limit: float) -> bool:
    return figure.share_ci is not None and figure.share_ci[0] > limit


def confusion(label: Labels, votes: IntArray) -> npt.NDArray[np.int64]:
    """[8, 8] counts: was (rows), answered (columns)."""
    n = len(CLASSES)
    return np.bincount(
        n * np.asarray(label) + answers_at(votes, "eight"), minlength=n * n
    ).reshape(n, n)


def spread_of(matrices: list[npt.NDArray[np.int64]]) -> RecallSpread:
    """Spread of the recall over retrainings. matrices: [8, 8] counts of each."""
    recalls = np.array(
        [np.diagonal(m) / np.maximum(m.sum(axis=1), 1) for m in matrices]
    )
    there = matrices[0].sum(axis=1) > 0
    span = np.where(there, np.ptp(recalls, axis=0), np.nan)
    return RecallSpread(
        recall={
            name: recalls[:, k].tolist() if there[k] else None
            for k, name in enumerate(CLASSES)
        },
        spread={
            name: float(span[k]) if there[k] else None for k, name in enumerate(CLASSES)
        },
        largest_spread=float(np.nanmax(span)),
        within_10_percent=bool(np.nanmax(span) <= 0.10 + 1e-9),
    )
