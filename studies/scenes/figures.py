"""Figures of the study of simulated scenes; `to_json` gives their part of scenes.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass, field

from holdfast.core.reading import Json
from holdfast.evaluation.window_scores import (
    ClassScores,
    LeakCheck,
    RecallSpread,
    RiskyCalls,
)


@dataclass(frozen=True)
class ShearRateFigures:
    """What the shear-rate threshold calls, at a window's last sample and anywhere in its 0.10 s."""

    law: str
    n_windows: int
    calls: RiskyCalls
    calls_anywhere_in_the_window: RiskyCalls


Rows = dict[str, ClassScores | ShearRateFigures]
"""Figures by the stored name of the method."""


@dataclass(frozen=True)
class OtherSetFigures:
    """Figures on all windows of a set that no method was trained on. data: what the set is."""

    data: Json
    rows: Rows


@dataclass(frozen=True)
class StyleLeftOut:
    """Figures on one style of forests that were trained on the other styles alone."""

    trained_on_trials: int
    rows: dict[str, ClassScores]


@dataclass(frozen=True)
class LearningPoint:
    """Figures by method from so many of the trials, trials held out."""

    trials: int
    windows: int
    rows: dict[str, ClassScores]

    def to_json(self) -> Json:
        """As it stands in scenes.json: macro F1 of four situations and of eight classes."""
        macro_f1 = {
            name: {
                level: {"macro_f1": one.macro_f1, "macro_f1_ci": one.macro_f1_ci}
                for level, one in (("four", row.four), ("eight", row.eight))
            }
            for name, row in self.rows.items()
        }
        return {"trials": self.trials, "windows": self.windows} | macro_f1


@dataclass(frozen=True)
class Retraining(RecallSpread):
    """Cross-validations with other seeds. confusion: [8, 8] counts of each."""

    seeds: list[int]
    confusion: list[list[list[int]]]


@dataclass(frozen=True)
class RateFigures:
    """All figures of one rate. data: what the set is. objects: method -> object held out.

    others: by card.

    leak: None where it was not checked. styles: None where only one style is there.
    """

    rate_hz: float
    window_samples: int
    data: Json
    rows: Rows
    retrainings: dict[str, Retraining]
    leak: LeakCheck | None = None
    objects: dict[str, dict[str, ClassScores]] = field(default_factory=dict)
    others: dict[str, OtherSetFigures] = field(default_factory=dict)
    styles: dict[str, StyleLeftOut] | None = None
    learning_curve: list[LearningPoint] = field(default_factory=list)

    def to_json(self) -> Json:
        """As it stands in scenes.json; styles have no key where only one is there."""
        figures = asdict(self)
        figures["learning_curve"] = [one.to_json() for one in self.learning_curve]
        if self.styles is None:
            del figures["styles"]
        return figures


@dataclass(frozen=True)
class ScenesFigures:
    """The figures of all rates by rate in Hz, slowest first; the fastest is the headline."""

    kind: str
    caveat: str
    rates: dict[str, RateFigures]

    @property
    def headline_hz(self) -> str:
        """The name of the headline's rate."""
        return list(self.rates)[-1]

    @property
    def leak(self) -> bool:
        """Whether the weight leaks at any rate."""
        return any(
            one.leak is not None and one.leak.leak for one in self.rates.values()
        )

    def to_json(self) -> Json:
        """As it stands in scenes.json."""
        return {
            "kind": self.kind,
            "caveat": self.caveat,
            "headline_hz": self.headline_hz,
            "leak": self.leak,
            "rates": {rate: one.to_json() for rate, one in self.rates.items()},
        }


@dataclass(frozen=True)
class MadeBy:
    """How figures were made. versions: of libraries. seconds: wall time, None where unknown."""

    seed: int = 0
    versions: dict[str, str] = field(default_factory=dict)
    command: str = "python -m studies scenes"
    seconds: float | None = None


def scores_of(rows: Rows, method: str) -> ClassScores:
    """The row of a method that answers with classes."""
    row = rows[method]
    if not isinstance(row, ClassScores):
        raise TypeError(f"{method} does not answer with classes")
    return row
