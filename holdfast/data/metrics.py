"""F1 of the situations, AUC and average precision, with intervals over people.

Windows of one person are not independent, hence the intervals resample people (groups), not
windows: B = 1000 draws with replacement, percentile 95 % (Efron & Tibshirani, "An Introduction to
the Bootstrap", 1993, chapter 13). With one group there is nothing to resample, and intervals are
None.

An absent figure is never guessed. The F1 of a class that is absent from the truth is None, whatever
was predicted (a window wrongly given to it already costs its true class recall). The macro F1
averages the classes in the truth; AUC and average precision are None with one class only. Draws in
which a figure is undefined do not count towards its interval. Without a single window every figure
is None.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass
from functools import lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import SITUATIONS, BoolArray, FloatArray, IntArray, Json
from holdfast.core.errors import LabelError, count_of

if TYPE_CHECKING:
    from holdfast.data.recording import DataSet

N_DRAWS = 1000
"""Draws of groups for an interval."""
INTERVAL_PERCENT = (2.5, 97.5)
"""Percentiles of the draws that bound a 95 % interval."""
Labels = npt.NDArray[np.integer[Any]]
ABSENT = "-"
"""What a table has for a class that is absent from the truth."""
PLURAL = {
    "person": "people",
    "object": "objects",
    "trial": "trials",
    "block": "blocks",
}
"""Of the kinds of group that are held out together."""
Interval = tuple[float, float]
"""The interval of a figure, 95 % unless stated."""


@dataclass(frozen=True)
class Share:
    """A share of n cases, 0 to 1, and its interval; None without a case."""

    share: float | None
    share_ci: Interval | None
    n: int


@dataclass(frozen=True)
class SituationFigures:
    """F1 by class, None where it is absent from the truth, and its mean over the others."""

    macro_f1: float | None
    macro_f1_ci: Interval | None
    f1: dict[str, float | None]
    f1_ci: dict[str, Interval | None]


@dataclass(frozen=True)
class PredictionFigures:
    """How well scores rank the windows before a risky slip above all others."""

    auc: float | None = None
    auc_ci: Interval | None = None
    average_precision: float | None = None
    average_precision_ci: Interval | None = None


@dataclass(frozen=True)
class HeadFigures:
    """Figures of a model's heads on a set. predict_250ms: None without that head.

    n_trials: recordings of the set. n_groups: groups that are held out in turn.
    group_kind: what is held out together, and what intervals resample: person, object, trial, ..
    """

    n_trials: int
    n_groups: int
    situations: SituationFigures
    predict_250ms: PredictionFigures | None
    group_kind: str = "trial"

    def to_json(self) -> Json:
        """As a model card and the reports of studies have it; an absent head has no key."""
        return {
            name: figure for name, figure in asdict(self).items() if figure is not None
        }


def report(
    data: DataSet,
    predicted: Labels,
    risky_score: FloatArray | None = None,
    *,
    not_learned: Collection[str] = (),
    seed: int = 0,
) -> HeadFigures:
    """All figures for answers at every window of a set.

    not_learned: situations that the model cannot tell, which have no figure.

    predicted [M]: situation at each window of the task "situations". risky_score [M2]: score at
    each window of the task "predict_250ms"; None where the model has no such head.
    """
    situations = situation_scores(
        data.tasks["situations"].label,
        predicted,
        data.group_of("situations"),
        not_learned=not_learned,
        seed=seed,
    )

    prediction = None
    if risky_score is not None:
        prediction = prediction_scores(
            data.tasks["predict_250ms"].label,
            risky_score,
            data.group_of("predict_250ms"),
            seed=seed,
        )

    return HeadFigures(
        n_trials=len(data.recordings),
        n_groups=len(data.groups()),
        situations=situations,
        predict_250ms=prediction,
        group_kind=data.group_kind,
    )


def situation_scores(
    truth: Labels,
    predicted: Labels,
    groups: npt.ArrayLike,
    *,
    not_learned: Collection[str] = (),
    n_draws: int = N_DRAWS,
    seed: int = 0,
) -> SituationFigures:
    """F1 by situation, its mean and their intervals, from labels [M], [M] and groups [M].

    not_learned: situations without a figure, because the model cannot answer them; what it says in
    their place still counts against the others. A prediction of len(SITUATIONS) means "unknown": an
    answer withheld, which misses what was there. Raises LabelError for any other number: -1, the
    decision's own "unknown", would silently count as another class' answer.
    """
    n = len(SITUATIONS)
    _require_labels(truth, n, "truth")
    _require_labels(predicted, n + 1, "prediction")
    code = _codes(groups)
    n_groups = int(code.max(initial=-1)) + 1

    # One count of all (group, truth, prediction) gives every draw by weighted sums.
    row = code * n + np.asarray(truth)
    cells = row * (n + 1) + np.asarray(predicted)
    counts = np.bincount(cells, minlength=n_groups * n * (n + 1))
    by_group = counts.reshape(-1, n, n + 1)

    # A draw counts the windows of a group as often as it drew the group.
    times_drawn = draw_groups(len(by_group), n_draws, seed)
    f1 = _f1(by_group.sum(axis=0))
    f1_draws = _f1(np.einsum("bg,gij->bij", times_drawn, by_group))
    figures: dict[str, float | None] = {}
    intervals: dict[str, Interval | None] = {}
    for k, name in enumerate(SITUATIONS):
        if name in not_learned:
            f1[k] = np.nan
            f1_draws[:, k] = np.nan
        figures[name] = _value(f1[k])
        intervals[name] = interval_of(f1_draws[:, k])

    # The macro F1 of each draw is taken before the percentiles: its interval is not the mean of
    # theirs.
    return SituationFigures(
        macro_f1=_value(float(macro(f1))),
        macro_f1_ci=interval_of(macro(f1_draws)),
        f1=figures,
        f1_ci=intervals,
    )


def prediction_scores(
    truth: Labels,
    score: FloatArray,
    groups: npt.ArrayLike,
    *,
    n_draws: int = N_DRAWS,
    seed: int = 0,
) -> PredictionFigures:
    """AUC, average precision and their intervals, from labels 0/1 [M], scores [M] and groups [M].

    Raises LabelError for another label; scikit-learn's ValueError for a score that is not finite.
    """
    truth = np.asarray(truth)
    _require_labels(truth, 2, "truth")
    # Without both classes there is nothing to rank.
    if len(np.unique(truth)) < 2:
        return PredictionFigures()

    # late: the reports of a study need no scikit-learn
    from sklearn.metrics import average_precision_score, roc_auc_score

    # By number and not by name: the order of the groups decides which of them a draw takes.
    code = _codes(groups)
    draws = draw_groups(int(code.max()) + 1, n_draws, seed)
    # Sorted once, best first, so that each draw costs one pass.
    order = np.argsort(-np.asarray(score), kind="stable")
    # Equal scores are one step of the curve, whatever the order of their rows.
    first = run_starts(np.asarray(score)[order])
    positive = truth[order] == 1
    figures = np.empty((len(draws), 2))
    for number, times_drawn in enumerate(draws):
        weight = times_drawn[code[order]]
        figures[number] = _auc_and_precision(weight, positive, first)
    return PredictionFigures(
        auc=float(roc_auc_score(truth, score)),
        auc_ci=interval_of(figures[:, 0]),
        average_precision=float(average_precision_score(truth, score)),
        average_precision_ci=interval_of(figures[:, 1]),
    )


def _auc_and_precision(
    weight: FloatArray, positive: BoolArray, first: IntArray
) -> tuple[float, float]:
    """AUC and average precision of rows with weights [M], best first; nan with only one class left.

    positive [M]. first [K]: where each run of equal scores begins. Equal to scikit-learn's on rows
    repeated `weight` times: ties count half, and precision steps at distinct scores.
    """
    of_hits = np.where(positive, weight, 0.0)
    of_misses = np.where(positive, 0.0, weight)
    # At each distinct score: the weight of its rows, then that of all rows down to it.
    hit = np.add.reduceat(of_hits, first)
    miss = np.add.reduceat(of_misses, first)
    hits = np.cumsum(hit)
    misses = np.cumsum(miss)
    all_hits = hits[-1]
    all_misses = misses[-1]
    if all_hits == 0.0 or all_misses == 0.0:
        return np.nan, np.nan

    # Each hit ranks above the misses after it, and half above those of its own score.
    below = all_misses - misses + 0.5 * miss
    auc = np.sum(hit * below) / (all_hits * all_misses)

    # A score without a hit adds nothing, and the first may have a weight of zero in all.
    zero = np.zeros_like(hits)
    precision = np.divide(hits, hits + misses, out=zero, where=hit > 0.0)
    average = np.sum(hit * precision) / all_hits
    return float(auc), float(average)


def run_starts(values: npt.NDArray[Any]) -> IntArray:
    """[K] where each run of equal values [M] begins."""
    begins = np.ones(len(values), dtype=np.bool_)
    begins[1:] = values[1:] != values[:-1]
    return np.flatnonzero(begins)


@lru_cache(maxsize=4)
def draw_groups(n_groups: int, n_draws: int, seed: int) -> FloatArray:
    """[B, G] how often each group is drawn, G draws with replacement; no row below two groups."""
    if n_groups < 2:
        return np.zeros((0, n_groups))

    # How often each group is drawn is all that a figure needs, so the draws themselves are not
    # kept.
    rng = np.random.default_rng(seed)
    drawn = rng.multinomial(n_groups, np.full(n_groups, 1.0 / n_groups), size=n_draws)
    draws = drawn.astype(np.float64)
    # The cache hands the same array out again, for the next figures of the same set.
    draws.setflags(write=False)
    return draws


def _require_labels(labels: npt.ArrayLike, n: int, what: str) -> None:
    """Raise LabelError where a label is not one of 0 .. n - 1."""
    foreign = np.setdiff1d(np.asarray(labels), np.arange(n))
    if foreign.size:
        raise LabelError(
            f"a {what} of {foreign[0]}, not of 0..{n - 1}",
            next_step="use the task's own labels",
        )


def _codes(groups: npt.ArrayLike) -> IntArray:
    """[M] number of each row's group, in order of the names; sorts one name a run of equal ones."""
    names = np.asarray(groups, dtype=str)
    # Windows of a group stand in runs, and sorting long texts takes longer than sorting numbers.
    starts = run_starts(names)
    code = np.unique(names[starts], return_inverse=True)[1].astype(np.int64)
    return np.repeat(code, np.diff(np.append(starts, len(names))))


def _f1(confusion: npt.NDArray[Any]) -> FloatArray:
    """[.., n, n + 1] counts (truth, predicted or withheld) -> [.., n] F1, nan without a truth."""
    true = confusion.sum(axis=-1)
    # The last column, answers withheld, is no class that could have been predicted.
    predicted = confusion[..., :-1].sum(axis=-2)
    right = np.diagonal(confusion, axis1=-2, axis2=-1)

    undefined = np.full(true.shape, np.nan)
    both = true + predicted
    return np.divide(2.0 * right, both, out=undefined, where=true > 0)


def macro(f1: FloatArray) -> FloatArray:
    """[.., n] -> [..] mean F1 over the classes in the truth, nan without one."""
    present = np.isfinite(f1)
    count = present.sum(axis=-1)

    # Written out and not nanmean, which warns of a draw in which no class has an F1.
    total = np.where(present, f1, 0.0).sum(axis=-1)
    undefined = np.full(total.shape, np.nan)
    return np.divide(total, count, out=undefined, where=count > 0)


def _value(figure: float) -> float | None:
    """A figure as JSON has it: None where it is not defined."""
    return float(figure) if np.isfinite(figure) else None


def interval_of(draws: FloatArray) -> Interval | None:
    """Percentiles of the draws [B] that are defined; None without one."""
    # A draw without a class in it has no figure, and counts neither as good nor as bad.
    defined = draws[np.isfinite(draws)]
    if not defined.size:
        return None

    low, high = np.percentile(defined, INTERVAL_PERCENT)
    return float(low), float(high)


# -- in words


def over(f1: Mapping[str, float | None]) -> str:
    """The classes that a macro F1 of these averages, if any is absent from the truth; else ""."""
    if None not in f1.values():
        return ""

    # Without this note a mean over three classes would be read as one over four.
    present = ", ".join(name for name, value in f1.items() if value is not None)
    return f"over {present.replace('_', ' ') or 'no class'} alone"


def situation_lines(
    of: SituationFigures, group_kind: str, not_learned: Collection[str] = ()
) -> list[str]:
    """The macro F1 and the classes it averages, then the F1 of each situation.

    group_kind: what the intervals resample. not_learned: what the model cannot tell.
    """
    macro = with_interval(of.macro_f1, of.macro_f1_ci, group_kind)
    lines = [f"macro F1 {over(of.f1) or 'over four situations'}  {macro}"]

    for name, f1 in of.f1.items():
        shown = "cannot tell"
        if name not in not_learned:
            shown = with_interval(f1, of.f1_ci[name], group_kind)
        lines.append(f"  F1 {name:<12} {shown}")
    return lines


def with_interval(
    value: float | None, interval: Interval | None, group_kind: str
) -> str:
    """A figure and its interval over groups of a kind; "-" where it is not defined."""
    if value is None:
        return ABSENT

    if not interval:
        return f"{value:.3f}"

    groups, (low, high) = PLURAL.get(group_kind, "groups"), interval
    return f"{value:.3f}  (95 % interval over {groups} {low:.3f} to {high:.3f})"


def in_words(n_groups: int, kind: str) -> str:
    """How many groups there are, and of what.

    >>> in_words(3, "person"), in_words(1, "object"), in_words(4, "trial")
    ('3 people', '1 object', '4 trials')
    """
    return count_of(n_groups, kind, PLURAL[kind])
