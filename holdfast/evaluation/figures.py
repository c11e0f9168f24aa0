"""All figures of an evaluation: each set, and all sets together; figures.json is made from them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass, field

from holdfast.core.reading import Json
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.evaluation.closing_hand import droppable
from holdfast.evaluation.methods import (
    MethodFigures,
    MethodResult,
    figures_of_methods,
    together,
)
from holdfast.evaluation.outcomes import OutcomeRow, outcome_table
from holdfast.evaluation.scored_set import ScoredSet, SetFigures, compared
from holdfast.evaluation.statistics import McNemar
from holdfast.evaluation.stream_pictures import ShownTrial
from holdfast.evaluation.thresholds import Thresholds


@dataclass(frozen=True)
class EvaluatedModel:
    """The model file that was evaluated. trained_on: None where its card does not say."""

    model_id: str
    rate_hz: float
    unit: str
    votes_for: list[str]
    trained_on: str | None

    @staticmethod
    def of(card: ModelCard) -> EvaluatedModel:
        """From the card of a model file."""
        trained_on = card.raw["training"].get("data")
        return EvaluatedModel(
            card.model_id, card.rate_hz, card.unit, list(card.classes), trained_on
        )


@dataclass(frozen=True)
class TimesMs:
    """ms of every event: to the first risky state, to the alarm; the lead there was, and left."""

    to_state: list[float]
    to_act: list[float]
    available: list[float]
    left: list[float]


@dataclass(frozen=True)
class Evaluation:
    """Everything the report shows. rows, mcnemar: of all sets together.

    thresholds: of the first set where each set has its own. shown, times: of pictures only.
    """

    model: EvaluatedModel
    thresholds: Thresholds
    seed: int
    sets: dict[str, SetFigures]
    rows: dict[str, MethodFigures]
    mcnemar: dict[str, McNemar]
    outcomes: list[OutcomeRow]
    shown: dict[str, list[ShownTrial]] = field(default_factory=dict)
    times: dict[str, TimesMs] = field(default_factory=dict)

    def to_json(self) -> Json:
        """figures.json; of one set alone, its window figures stand on top."""
        first = next(iter(self.sets.values()))
        alone = len(self.sets) == 1
        return (
            first.windows.to_json() if alone else {"model_id": self.model.model_id}
        ) | {
            "model": asdict(self.model),
            "thresholds": self.thresholds.to_json(),
            "seed": self.seed,
            "sets": {name: one.to_json() for name, one in self.sets.items()},
            "all": {
                "rows": {name: asdict(one) for name, one in self.rows.items()},
                "mcnemar": {name: asdict(one) for name, one in self.mcnemar.items()},
            },
            "outcomes": [asdict(one) for one in self.outcomes],
        }


def all_sets(
    card: ModelCard, scored: dict[str, ScoredSet], thresholds: Thresholds, seed: int
) -> Evaluation:
    """The figures of all sets together."""
    results = list(scored.values())
    methods = {
        name: together([one.methods[name] for one in results])
        for name in results[0].methods
    }
    trials = [trial for one in results for trial in one.trials]
    bounds = droppable([drop for one in results for drop in one.drops])
    headline = thresholds.headline
    return Evaluation(
        EvaluatedModel.of(card),
        thresholds,
        seed,
        {name: one.figures for name, one in scored.items()},
        figures_of_methods(methods, trials, bounds, seed),
        compared(methods, thresholds),
        outcome_table([trial for one in results for trial in one.judged]),
        next((one.shown for one in results if one.shown), {}),
        {
            name: _times(one.methods[headline], one.to_state_ms)
            for name, one in scored.items()
            if one.figures.card.events
        },
    )


def _times(method: MethodResult, to_state_ms: list[float]) -> TimesMs:
    found = [o for one in method.matches for o in one.outcomes if o.delay_s is not None]
    return TimesMs(
        to_state_ms,
        _ms([o.delay_s for o in found]),
        _ms([o.available_s for o in found]),
        _ms([o.lead_s for o in found]),
    )


def _ms(seconds: Sequence[float | None]) -> list[float]:
    return [1e3 * one for one in seconds if one is not None]
