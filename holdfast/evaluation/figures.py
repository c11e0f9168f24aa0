"""All figures of an evaluation: each set, and all sets together; figures.json is made from them."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field

from holdfast.core.contract import Json, untold_of
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.evaluation.methods import (
    MethodFigures,
    TrialOutcome,
    figures_of_methods,
)
from holdfast.evaluation.scored_set import ScoredSet, SetFigures, compared
from holdfast.evaluation.statistics import McNemar
from holdfast.evaluation.thresholds import Thresholds
from holdfast.evaluation.trials import AnsweredTrial


@dataclass(frozen=True)
class EvaluatedModel:
    """The model file that was evaluated.

    trained_on: None where its card does not say. cannot_tell: what its data did not show, with the
    reason.
    """

    model_id: str
    rate_hz: float
    unit: str
    votes_for: list[str]
    trained_on: str | None
    cannot_tell: dict[str, str]


@dataclass
class TimesMs:
    """ms of every event: to the first risky state, to the alarm; the lead there was, and left."""

    to_state: list[float]
    to_act: list[float] = field(default_factory=list)
    available: list[float] = field(default_factory=list)
    left: list[float] = field(default_factory=list)


@dataclass(frozen=True)
class Evaluation:
    """Everything the report shows. rows, mcnemar: of all sets together.

    thresholds: of the first set where each set has its own. drawn, times, central: of pictures.
    """

    model: EvaluatedModel
    thresholds: Thresholds
    seed: int
    sets: dict[str, SetFigures]
    rows: dict[str, MethodFigures]
    mcnemar: dict[str, McNemar]
    drawn: dict[str, list[AnsweredTrial]] = field(default_factory=dict)
    times: dict[str, TimesMs] = field(default_factory=dict)
    central: AnsweredTrial | None = None

    def to_json(self) -> Json:
        """figures.json; of one set alone, its window figures stand on top."""
        # As the file was before several sets could be evaluated: its readers find them there.
        top = {"model_id": self.model.model_id}
        if len(self.sets) == 1:
            top = next(iter(self.sets.values())).windows.to_json()

        return top | {
            "model": asdict(self.model),
            "thresholds": self.thresholds.to_json(),
            "seed": self.seed,
            "sets": {name: one.to_json() for name, one in self.sets.items()},
            "all": {
                "rows": {name: asdict(one) for name, one in self.rows.items()},
                "mcnemar": {name: asdict(one) for name, one in self.mcnemar.items()},
            },
        }


def all_sets(
    card: ModelCard, scored: Mapping[str, ScoredSet], thresholds: Thresholds, seed: int
) -> Evaluation:
    """The figures of all sets together."""
    methods: dict[str, list[TrialOutcome]] = {}
    drawn: dict[str, list[AnsweredTrial]] = {}
    central = None
    times = {}
    for name, one in scored.items():
        for method, outcomes in one.methods.items():
            # By name: with other settings for each set it is still the same method. Its events
            # and minutes are counted as those of one set, which is no mean over sets.
            methods.setdefault(method, []).extend(outcomes)

        # The first set with a trial to draw stands for all.
        drawn = drawn or one.drawn
        central = central or one.central
        # A set without events has no delays to draw.
        if one.figures.card.events:
            headline = one.methods[thresholds.headline]
            times[name] = _times(headline, one.to_state_ms)

    model = EvaluatedModel(
        model_id=card.model_id,
        rate_hz=card.rate_hz,
        unit=card.unit,
        votes_for=list(card.classes),
        trained_on=card.raw["training"].get("data"),
        cannot_tell=untold_of(card.raw),
    )

    return Evaluation(
        model=model,
        thresholds=thresholds,
        seed=seed,
        sets={name: one.figures for name, one in scored.items()},
        rows=figures_of_methods(methods, seed),
        mcnemar=compared(methods, thresholds),
        drawn=drawn,
        times=times,
        central=central,
    )


def _times(of: Sequence[TrialOutcome], to_state_ms: list[float]) -> TimesMs:
    # A state may come without an alarm, so the lists differ in length.
    times = TimesMs(to_state_ms)
    for one in of:
        for outcome in one.match.outcomes:
            if outcome.delay_s is None:
                continue
            times.to_act.append(1e3 * outcome.delay_s)
            # A recorded event may have an onset and no known gross slip.
            if outcome.available_s is not None and outcome.lead_s is not None:
                times.available.append(1e3 * outcome.available_s)
                times.left.append(1e3 * outcome.lead_s)

    return times
