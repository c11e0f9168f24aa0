"""Figures at the windows of a set: of situations, of the 0.25 s prediction, and shares.

F1, AUC, average precision and shares are from 0 to 1. A figure that is not defined is None, and so
is an interval with less than two groups.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass

from edge_runtime.reading import Json

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
    """F1 by class, and its mean over the classes that occur."""

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

    group_kind: what is held out together, and what intervals resample: person, object, trial, ..
    """

    n_trials: int
    n_groups: int
    situations: SituationFigures
    predict_250ms: PredictionFigures | None
    group_kind: str = "trial"

    def to_json(self) -> Json:
        """As a model card and the reports of studies have it; an absent head has no key."""
        return {name: figure for name, figure in asdict(self).items() if figure is not None}
