"""Five learners on the cases: equal classes, groups on one side only, five repetitions.

Learners are scikit-learn's at their defaults, untuned, for the thesis names no settings. Nearest
neighbours and the neural network see standardised features, because distances and gradients depend
on the scale and trees do not; gradient boosting is the histogram kind. A repetition draws the
windows, deals the groups anew into four folds of which one is the test (25 %), and seeds the
learners.

Equal classes: all have the same number of windows, and within "safe" the three kinds have too. So
chance is one over the number of classes, and a figure in the thesis' % can be read beside ours.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
import numpy.typing as npt
from sklearn.ensemble import HistGradientBoostingClassifier, RandomForestClassifier
from sklearn.metrics import accuracy_score
from sklearn.naive_bayes import GaussianNB
from sklearn.neighbors import KNeighborsClassifier
from sklearn.neural_network import MLPClassifier
from sklearn.pipeline import make_pipeline
from sklearn.preprocessing import StandardScaler
from threadpoolctl import threadpool_limits

from holdfast.core.errors import ClassMissing
from holdfast.core.progress import Say
from holdfast.data.recording import DataSet, assign_groups, folds_of
from holdfast.training.network_fit import interruptible
from studies.thesis_preliminary.cases import CASES, Case
from studies.thesis_preliminary.figures import CaseFigures, Repetitions, StudiedSet
from studies.thesis_preliminary.points import (
    KINDS,
    SLIPPING,
    Points,
    points_of,
    windows,
)
from studies.thesis_preliminary.published import LEARNERS

REPETITIONS = 5
FOLDS = 4
Rows = npt.NDArray[np.int64]
_MAKERS: tuple[Callable[[int], Any], ...] = (
    lambda seed: RandomForestClassifier(n_estimators=100, random_state=seed),
    lambda seed: make_pipeline(StandardScaler(), KNeighborsClassifier()),
    lambda seed: GaussianNB(),
    lambda seed: HistGradientBoostingClassifier(random_state=seed),
    lambda seed: make_pipeline(
        StandardScaler(), MLPClassifier(max_iter=2000, random_state=seed)
    ),
)
MAKE: dict[str, Callable[[int], Any]] = dict(zip(LEARNERS, _MAKERS, strict=True))
"""Name -> what makes the learner from a seed."""


@dataclass(frozen=True)
class Draw:
    """One repetition: points to train on and to test on, and the learners' seed."""

    train: Rows
    test: Rows
    seed: int


def study(
    data: DataSet,
    cases: Sequence[Case] = CASES,
    *,
    seed: int = 0,
    say: Say = lambda line: None,
) -> StudiedSet:
    """All figures of a set. Raises ClassMissing where a kind of point is missing, TooFewGroups."""
    points = points_of(data)
    say(f"{data.name}: {len(points)} critical points")
    figures = {}
    for case in cases:
        figures[case.name] = case_figures(data, points, case, seed)
        say(f"{data.name}: case {case.name}")
    counts = np.bincount(points.kind, minlength=len(KINDS)).tolist()
    return StudiedSet(
        data=data.name,
        kind=data.kind,
        rate_hz=data.rate_hz,
        sensors=data.n_sensors,
        groups=len(data.groups()),
        trials=len(data.recordings),
        caveat=data.caveat,
        points=dict(zip(KINDS, counts, strict=True)),
        late=late_share(points),
        cases=figures,
    )


def case_figures(data: DataSet, points: Points, case: Case, seed: int) -> CaseFigures:
    """Figures of one case: windows, chance, and accuracies of every learner."""
    samples = windows(data, points, case.first, case.last)
    label = case.labels(points.kind)
    draws = repetitions(points, case, seed)
    scores: dict[str, list[float]] = {name: [] for name in MAKE}
    with threadpool_limits(1):  # so few rows: threads would wait for each other
        for draw in draws:
            train, test = (
                case.features(samples[draw.train], samples[rows]).reshape(len(rows), -1)
                for rows in (draw.train, draw.test)
            )
            for name, make in MAKE.items():
                with interruptible():
                    fitted = make(draw.seed).fit(train, label[draw.train])
                answer = fitted.predict(test)
                scores[name].append(accuracy_score(label[draw.test], answer))
    return CaseFigures(
        what=case.what,
        classes=list(case.classes),
        windows=len(draws[0].train) + len(draws[0].test),
        chance=1.0 / len(case.classes),
        accuracy={name: repeated(each) for name, each in scores.items()},
    )


def repetitions(points: Points, case: Case, seed: int) -> list[Draw]:
    """The five repetitions of a case."""
    draws = []
    for repetition in range(REPETITIONS):
        own = int(np.random.SeedSequence([seed, repetition]).generate_state(1)[0])
        rows = balanced(points.kind, case, own)
        groups = points.group[rows]
        train, test = folds_of(groups, assign_groups(groups, FOLDS, seed=own))[0]
        draws.append(Draw(rows[train], rows[test], own))
    return draws


def balanced(kind: Rows, case: Case, seed: int) -> Rows:
    """Equally many points of each class, and of each kind within it, drawn by the seed; ascending.

    Raises ClassMissing where there is no point of a kind.
    """
    counts = np.bincount(kind, minlength=len(KINDS))
    if not counts.all():
        missing = ", ".join(
            name for name, count in zip(KINDS, counts, strict=True) if not count
        )
        raise ClassMissing(
            f"no critical point of {missing}",
            next_step="use more trials, some of disturbed holds",
        )
    label = case.labels(np.arange(len(KINDS)))
    kinds_in = np.bincount(label)
    per_class = min(int(counts[k]) * int(kinds_in[label[k]]) for k in range(len(KINDS)))
    rng = np.random.default_rng(seed)
    taken = [
        rng.permutation(np.flatnonzero(kind == k))[: per_class // kinds_in[label[k]]]
        for k in range(len(KINDS))
    ]
    return np.sort(np.concatenate(taken))


def late_share(points: Points) -> float | None:
    """Share of slipping points whose known onset precedes the end of a predicting window."""
    since = points.since_onset[
        (points.kind == SLIPPING) & np.isfinite(points.since_onset)
    ]
    return float((since >= 1.0).mean()) if len(since) else None


def repeated(values: Sequence[float]) -> Repetitions:
    """Mean, standard deviation (of a sample), and each."""
    each = [float(value) for value in values]
    return Repetitions(float(np.mean(values)), float(np.std(values, ddof=1)), each)
