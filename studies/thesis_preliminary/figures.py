"""Figures of the preliminary study; `PreliminaryStudy.to_json` gives preliminary.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from holdfast.core.contract import Json
from studies.thesis_preliminary.published import ACCURACY_PERCENT, LEARNERS, SOURCE


@dataclass(frozen=True)
class Repetitions:
    """A figure in every repetition, its mean and its standard deviation (of a sample)."""

    mean: float
    sd: float
    each: list[float]


@dataclass(frozen=True)
class CaseFigures:
    """Figures of one case. windows: in a repetition. chance: one over the number of classes.

    accuracy: by learner, 0 to 1.
    """

    what: str
    classes: list[str]
    windows: int
    chance: float
    accuracy: dict[str, Repetitions]


@dataclass(frozen=True)
class StudiedSet:
    """All figures of a set. points: critical points of each kind. cases: by name.

    late: share of the risky predicting windows at whose end the event has begun, 0 to 1, None where
    no onset is known.
    """

    data: str
    kind: str
    rate_hz: float
    sensors: int
    groups: int
    trials: int
    caveat: str
    points: dict[str, int]
    late: float | None
    cases: dict[str, CaseFigures]


@dataclass(frozen=True)
class PreliminaryStudy:
    """Every set beside the thesis. seconds: wall time of the whole command."""

    sets: list[StudiedSet]
    repetitions: int
    seed: int
    versions: dict[str, str]
    seconds: float

    def to_json(self) -> Json:
        """preliminary.json; what the thesis published stands first."""
        percent = ACCURACY_PERCENT
        thesis = {
            "source": SOURCE,
            "learners": list(LEARNERS),
            "accuracy_percent": percent,
        }
        return {"thesis": thesis, **asdict(self)}
