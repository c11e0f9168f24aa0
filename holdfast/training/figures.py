"""Figures at the windows of a set: of situations, of the 0.25 s prediction, and shares.

F1, AUC, average precision and shares are from 0 to 1. A figure that is not defined is None, and so
is an interval with less than two groups.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import asdict, dataclass

from holdfast.core.contract import Json
from holdfast.core.errors import count_of

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


def over(f1: Mapping[str, float | None]) -> str:
    """The classes that a macro F1 of these averages, if any is absent from the truth; else ""."""
    if None not in f1.values():
        return ""

    # Without this note a mean over three classes would be read as one over four.
    present = [
        name.replace("_", " ") for name, value in f1.items() if value is not None
    ]
    return f"over {', '.join(present) or 'no class'} alone"


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
