"""What a trained model is judged by: what is held out together, and how more data would help.

The strictest hold-out that the data allow: person, else object, else trial. Never a
window: neighbours in time are nearly the same, and a model that saw one knows the other.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np

from holdfast.core.errors import TooFewGroups
from holdfast.core.progress import Say, ignored
from holdfast.data.metrics import HeadFigures, Interval, report
from holdfast.data.recording import (
    DataSet,
    Fold,
    HoldOut,
    regrouped,
    with_learned_weight,
)
from holdfast.training.crossval import (
    FloatRows,
    HeldOut,
    answer_fold,
    main_task,
    splits_of,
)
from holdfast.training.plan import TrainingPlan

STRICTEST_FIRST: tuple[HoldOut, ...] = ("person", "object", "trial")
SHARES = (0.25, 0.5, 0.75)
"""Of the groups a fold trains on; the last point is the whole, the held-out figure itself."""
MOST_NAMED = 3
"""Groups that a reason names."""


@dataclass(frozen=True)
class CurvePoint:
    """The held-out macro F1 of models trained on fewer groups and trials (means over folds)."""

    n_groups: float
    n_trials: float
    macro_f1: float | None
    macro_f1_ci: Interval | None


@dataclass(frozen=True)
class HoldOutChoice:
    """A set with the groups that are held out, and why these.

    skipped: a stricter hold-out that is not taken -> why. lacks: what a fold even so cannot learn,
    in words; "" where every fold learns what it should.
    """

    data: DataSet
    skipped: dict[str, str] = field(default_factory=dict)
    lacks: str = ""

    @property
    def kind(self) -> str:
        return self.data.group_kind

    def lines(self) -> list[str]:
        """The reasons as sentences for people."""
        return [f"not held out by {kind}: {why}" for kind, why in self.skipped.items()]


def strictest_hold_out(data: DataSet, folds: int, seed: int) -> HoldOutChoice:
    """The first of STRICTEST_FIRST with which every fold learns every situation of the set.

    Objects are held out only where every fold learns both weights, too.

    Where there is no such, the last one that makes two groups. A set whose reader has its own kind
    of group, such as blocks, keeps it.
    """
    if data.group_kind not in STRICTEST_FIRST:
        return as_grouped(data, folds, seed)

    skipped: dict[str, str] = {}
    last = HoldOutChoice(data)
    for kind in STRICTEST_FIRST:
        try:
            candidate = regrouped(data, kind)
        except TooFewGroups as error:
            skipped[kind] = error.cause
            continue
        last = as_grouped(candidate, folds, seed)
        if not last.lacks:
            break
        skipped[kind] = last.lacks

    # What is taken is not skipped, whatever it lacks.
    skipped.pop(last.kind, None)
    return replace(last, skipped=skipped)


def as_grouped(data: DataSet, folds: int, seed: int) -> HoldOutChoice:
    """The set with the groups that it has, and what the first such fold lacks."""
    main = main_task(data)
    groups = data.group_of(main)
    rows = data.tasks[main].of_situations()
    # An object brings its weight: votes of models that lack one would calibrate it the wrong way
    # round.
    if data.group_kind == "object":
        learned = with_learned_weight(data)
        rows = learned.tasks[main_task(learned)]
    label = rows.label
    n_folds = min(folds, len(np.unique(groups)))
    if n_folds < 2:
        return HoldOutChoice(data, lacks=f"one {data.group_kind} alone")

    for split in splits_of(data, TrainingPlan(folds=n_folds), seed):
        train, test = split[main]
        gone = np.setdiff1d(label[test], label[train])
        if gone.size:
            those = test[label[test] == gone[0]]
            names = " and ".join(np.unique(groups[those])[:MOST_NAMED])
            what = _in_words(rows.classes[gone[0]])
            return HoldOutChoice(data, lacks=f"without {names} no {what} is left")
    return HoldOutChoice(data)


def _in_words(name: str) -> str:
    """A situation, or a class: a situation and a weight."""
    situation, _, weight = name.rpartition("_")
    if weight not in ("light", "heavy"):
        return name.replace("_", " ")
    return f"{situation.replace('_', ' ')} with a {weight} object"


def held_out_figures(data: DataSet, held_out: HeldOut, seed: int = 0) -> HeadFigures:
    """Metrics of the held-out votes, situations always four."""
    # The second class is the one that slips within 0.25 s.
    score = None
    if "predict_250ms" in data.tasks:
        score = held_out.shares("predict_250ms")[:, 1]
    return report(data.with_situations(), held_out.situations(), score, seed=seed)


def learning_curve(
    data: DataSet,
    features: dict[str, FloatRows],
    plan: TrainingPlan,
    seed: int,
    whole: HeadFigures,
    say: Say = ignored,
) -> list[CurvePoint]:
    """Held-out figures where each fold trains on a share of its groups only.

    The windows that are answered stay the same, so the points differ by the training data alone.
    A share with which a fold has a class no more is left out. whole: the figures with all of them,
    which are known already. No point where only the whole is left: one point is no curve.
    """
    # The prediction ahead is not drawn, so it is not trained again.
    main = main_task(data)
    one_task = replace(data, tasks={main: data.tasks[main]})
    label = one_task.tasks[main].label
    # By groups: with few of them two shares are the same, and the largest may be the whole.
    points: dict[float, CurvePoint] = {}
    for share in (*SHARES, 1.0):
        folds = _cut(one_task, plan, share, seed)
        figures = whole
        if share < 1.0:
            fewest = min(len(np.unique(label[train])) for train, _ in folds)
            if fewest < len(np.unique(label)):
                continue
            say(f"learning curve: {share:.0%} of the training data")
            answers = []
            for fold in folds:
                split = {main: fold}
                answers.append(answer_fold(one_task, features, plan, split, seed))
            figures = held_out_figures(one_task, HeldOut.of(one_task, answers), seed)
        point = _point(one_task, folds, figures)
        points[point.n_groups] = point
    return list(points.values()) if len(points) > 1 else []


def _cut(data: DataSet, plan: TrainingPlan, share: float, seed: int) -> list[Fold]:
    """The folds of the main task, with this share of their training groups, one at least.

    A larger share has all groups of a smaller one.
    """
    main = main_task(data)
    groups = data.group_of(main)
    folds = []
    for split in splits_of(data, plan, seed):
        train, test = split[main]
        names = np.random.default_rng(seed).permutation(np.unique(groups[train]))
        kept = names[: max(1, round(share * len(names)))]
        folds.append((train[np.isin(groups[train], kept)], test))
    return folds


def _point(data: DataSet, folds: Sequence[Fold], figures: HeadFigures) -> CurvePoint:
    """The figures, with the groups and trials that a fold trains on."""
    main = main_task(data)
    groups, trial = data.group_of(main), data.tasks[main].trial
    sizes = [[len(set(of[train])) for of in (groups, trial)] for train, _ in folds]
    n_groups, n_trials = np.mean(sizes, axis=0).tolist()
    of = figures.situations
    return CurvePoint(n_groups, n_trials, of.macro_f1, of.macro_f1_ci)
