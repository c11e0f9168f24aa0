"""Figures of the fast hand-over study; `HandoverStudy.to_json` gives figures.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from holdfast.core.reading import Json
from holdfast.evaluation.alarms import EventScores
from holdfast.evaluation.methods import HoldFigures, MethodFigures
from holdfast.evaluation.statistics import Spread
from holdfast.training.figures import Interval, Share


@dataclass(frozen=True)
class SetAlarms:
    """Alarms on one set, as evaluation.methods.MethodFigures has them."""

    events: int
    recall: float | None
    recall_ci: Interval | None
    false_per_min: float | None
    false_per_min_ci: Interval | None
    in_time: float | None
    delay_ms: Spread | None
    safe_acts_called: Share
    specificity: dict[str, HoldFigures] | None

    @staticmethod
    def of(figures: MethodFigures) -> SetAlarms:
        """The figures that a row keeps."""
        return SetAlarms(
            **{name: getattr(figures, name) for name in SetAlarms.__annotations__}
        )


@dataclass(frozen=True)
class UnseenStyles:
    """Alarms on both unseen styles together."""

    events: int
    recall: float | None
    recall_ci: Interval | None
    false_per_min: float | None

    @staticmethod
    def of(scores: EventScores) -> UnseenStyles:
        """The figures that a row keeps."""
        return UnseenStyles(
            scores.events, scores.recall, scores.recall_ci, scores.false_per_min
        )


@dataclass(frozen=True)
class AlarmFigures:
    """Alarms of one idea. permille: threshold by set. sets: by name of the evaluated set.

    state_delay_ms: from load onset to the first risky state.
    """

    permille: dict[str, int]
    sets: dict[str, SetAlarms]
    unseen_style: UnseenStyles
    state_delay_ms: Spread | None

    def to_json(self) -> Json:
        """As it stands in a row of figures.json."""
        fields = asdict(self)
        sets = fields.pop("sets")
        return {"permille": fields.pop("permille"), **sets, **fields}


@dataclass(frozen=True)
class WindowF1:
    """Macro F1 at windows: at all, and at those at least 20 ms past a change of phase."""

    f1: float
    f1_past: float


@dataclass(frozen=True)
class IdeaFigures:
    """One row. windows: by style. worst_object: macro F1, None where no object is left out.

    learner_us: median of one answer.
    """

    idea: str
    alarms: AlarmFigures
    windows: dict[str, WindowF1]
    worst_object: float | None
    learner_us: float = 0.0

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        row: Json = {"idea": self.idea} | self.alarms.to_json()
        for style, one in self.windows.items():
            row |= {f"f1_{style}": one.f1, f"f1_{style}_past": one.f1_past}
        worst = {} if self.worst_object is None else {"worst_object": self.worst_object}
        return row | worst | {"learner_us": self.learner_us}


@dataclass(frozen=True)
class LateObserver:
    """Macro F1 of an observer that knows the truth, but some samples late."""

    samples_late: int
    ms_late: float
    f1_author: float


@dataclass(frozen=True)
class HandoverStudy:
    """Every idea, and what an observer that is late would reach."""

    rows: list[IdeaFigures]
    bounds: list[LateObserver]

    def to_json(self) -> Json:
        """figures.json."""
        rows = [row.to_json() for row in self.rows]
        return {
            "kind": "simulated",
            "rows": rows,
            "bounds": [asdict(one) for one in self.bounds],
        }
