"""Figures of the study of simulated scenes; `to_json` gives a rate's part of scenes.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Any

from evaluation.scores import ClassScores, LeakCheck, RecallSpread, RiskyCalls


@dataclass(frozen=True)
class DescribedSet:
    """What a set is. made_from: of its meta.json. counts: of windows and samples."""

    name: str
    kind: str
    n_trials: int
    made_from: dict[str, Any]
    counts: dict[str, Any]

    def to_json(self) -> dict[str, Any]:
        """As it stands in scenes.json."""
        known = {"name": self.name, "kind": self.kind, "n_trials": self.n_trials}
        return known | self.made_from | self.counts


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
    """Figures on all windows of a set that no method was trained on."""

    data: DescribedSet
    rows: Rows

    def to_json(self) -> dict[str, Any]:
        """As it stands in scenes.json."""
        return {"data": self.data.to_json(), "rows": rows_json(self.rows)}


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

    def to_json(self) -> dict[str, Any]:
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
class Retraining:
    """Cross-validations with other seeds. confusion: [8, 8] counts of each."""

    seeds: list[int]
    confusion: list[list[list[int]]]
    spread: RecallSpread

    def to_json(self) -> dict[str, Any]:
        """As it stands in scenes.json."""
        return {"seeds": self.seeds, "confusion": self.confusion} | asdict(self.spread)


@dataclass(frozen=True)
class RateFigures:
    """All figures of one rate. objects: method -> object held out. others: by card.

    styles: None where only one style is there.
    """

    rate_hz: float
    window_samples: int
    data: DescribedSet
    rows: Rows
    leak: LeakCheck
    objects: dict[str, dict[str, ClassScores]]
    others: dict[str, OtherSetFigures]
    styles: dict[str, StyleLeftOut] | None
    learning_curve: list[LearningPoint]
    retrainings: dict[str, Retraining]

    def to_json(self) -> dict[str, Any]:
        """As it stands in scenes.json."""
        figures = {
            "rate_hz": self.rate_hz,
            "window_samples": self.window_samples,
            "data": self.data.to_json(),
            "rows": rows_json(self.rows),
            "leak": asdict(self.leak),
            "objects": {name: rows_json(one) for name, one in self.objects.items()},
            "others": {card: one.to_json() for card, one in self.others.items()},
        }
        if self.styles is not None:
            figures["styles"] = {style: asdict(one) for style, one in self.styles.items()}
        return figures | {
            "learning_curve": [point.to_json() for point in self.learning_curve],
            "retrainings": {name: one.to_json() for name, one in self.retrainings.items()},
        }


def rows_json(rows: Rows | dict[str, ClassScores]) -> dict[str, Any]:
    """Rows as they stand in scenes.json."""
    return {name: asdict(row) for name, row in rows.items()}
