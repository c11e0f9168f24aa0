"""Figures of learners on streams; `LearnerRow.to_json` gives a row of learner-streams.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from holdfast.core.reading import Json
from holdfast.evaluation.methods import MethodFigures
from holdfast.evaluation.statistics import Spread
from holdfast.training.figures import Interval, Share


@dataclass(frozen=True)
class StreamFigures:
    """Alarms on some streams. in_time: share of risky slips called before gross slip.

    safe_acts_called: share of voluntary actions that were called risky.
    """

    events: int
    recall: float | None
    recall_ci: Interval | None
    in_time: float | None
    false_per_min: float | None
    false_per_min_ci: Interval | None
    safe_acts_called: Share
    delay_ms: Spread | None

    @staticmethod
    def of(figures: MethodFigures) -> StreamFigures:
        """The figures that a row keeps."""
        names = StreamFigures.__annotations__
        return StreamFigures(**{name: getattr(figures, name) for name in names})


@dataclass(frozen=True)
class CurvePoint:
    """Both unseen styles at a threshold. called: share of voluntary actions called risky."""

    permille: int
    recall: float | None
    in_time: float | None
    false_per_min: float | None
    called: float


@dataclass(frozen=True)
class LearnerRow:
    """A learner trained on `thesis` and `broad`, and on the other styles alone.

    permille: its threshold. sets: by name. unseen: both unseen styles, together.
    left_out: the same for three learners, each trained without the style it is evaluated on.
    curve: the unseen styles at other thresholds.
    learner_us, step_us: median of the learner and of a whole step.
    """

    name: str
    learner: str
    permille: int
    sets: dict[str, StreamFigures]
    unseen: StreamFigures
    left_out: StreamFigures
    curve: list[CurvePoint]
    learner_us: float = 0.0
    step_us: float = 0.0

    def to_json(self) -> Json:
        """As it stands in learner-streams.json."""
        return asdict(self)
