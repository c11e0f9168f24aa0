"""One set scored by every method, and all sets together; figures.json is made from them."""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from typing import NamedTuple

from holdfast.core.contract import BoolArray, Json
from holdfast.core.progress import Part, ignored
from holdfast.core.trial_layout import read_json
from holdfast.data.recording import DataSet
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.evaluation.alarms import EventTimes, event_times, requests_at
from holdfast.evaluation.baselines import Baseline, Thresholds
from holdfast.evaluation.formats import McNemar, mcnemar
from holdfast.evaluation.methods import (
    MethodFigures,
    TrialOutcome,
    detected,
    figures_of_methods,
    outcomes_of,
)
from holdfast.evaluation.model_outputs import ModelOutputs, WindowFigures
from holdfast.evaluation.states import StateFigures, risky_states, state_figures
from holdfast.evaluation.trials import (
    AnsweredTrial,
    LabelledTrial,
    central_trial,
    drawn_trials,
    labelled_trials,
)

MADE_FROM = ("title", "card_sha256", "seed", "effects")
"""Keys of a set's meta.json that its figures repeat."""


def _json(rows: Mapping[str, MethodFigures] | Mapping[str, McNemar]) -> Json:
    return {name: asdict(one) for name, one in rows.items()}


@dataclass(frozen=True)
class SetCard:
    """What a set is. made_from: those of MADE_FROM that its meta.json has.

    timed: some of its labels have times; without any, no alarm is right or wrong.
    """

    name: str
    kind: str
    made_from: Json
    rate_hz: float
    unit: str
    recordings: int
    groups: int
    group_kind: str
    minutes: float
    events: int
    samples: dict[str, int] | None
    onsets_by: dict[str, int]
    trained_on_recordings: int
    caveat: str
    timed: bool

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        # The keys of made_from stand among the others.
        figures = asdict(self)
        return figures.pop("made_from") | figures


@dataclass(frozen=True)
class SetFigures:
    """Figures of one set. windows: figures at single windows. rows: by stored name of the method.

    thresholds: None where all sets share those that were chosen elsewhere.
    """

    card: SetCard
    windows: WindowFigures
    rows: dict[str, MethodFigures]
    states: StateFigures
    mcnemar: dict[str, McNemar]
    thresholds: Thresholds | None

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        figures = {
            "data": self.card.to_json(),
            "windows": self.windows.to_json(),
            "rows": _json(self.rows),
            "states": asdict(self.states),
            "mcnemar": _json(self.mcnemar),
        }
        if self.thresholds:
            figures["thresholds"] = self.thresholds.to_json()
        return figures


@dataclass(frozen=True)
class ScoredSet:
    """A set with what the figures of all sets together need.

    methods: stored name -> the outcome of each trial. drawn: trials of a report, by title. central:
    one of them, with its samples. to_state_ms: load onset to the first risky state.
    """

    figures: SetFigures
    methods: dict[str, list[TrialOutcome]]
    drawn: dict[str, list[AnsweredTrial]]
    central: AnsweredTrial | None
    to_state_ms: list[float]


def score_set(
    root: Path,
    data: DataSet,
    card: ModelCard,
    outputs: list[ModelOutputs],
    thresholds: Thresholds,
    baselines: Sequence[Baseline],
    windows: WindowFigures,
    seed: int,
    part: Part = ignored,
) -> ScoredSet:
    """Score every method on a set. outputs: of the model, for each of the set's recordings."""
    trials = labelled_trials(root, data.recordings)
    requests = _requests(data, outputs, thresholds, baselines)
    methods = {name: outcomes_of(trials, on) for name, on in requests.items()}

    headline = thresholds.headline
    # States are shown at the confidence of the headline, and so fit its alarms.
    risky = risky_states(outputs, thresholds.confidences[headline])
    states = state_figures(outputs, risky, seed, card.not_learned)
    part(0.5)

    figures = SetFigures(
        card=_card(root, data, trials, windows),
        windows=windows,
        rows=figures_of_methods(methods, seed),
        states=states,
        mcnemar=compared(methods, thresholds),
        # Thresholds that were chosen elsewhere are the same for all sets and stand on top.
        thresholds=thresholds if thresholds.chosen is None else None,
    )

    answered = []
    # At the headline's confidence: the pictures show what the table counts.
    for trial, of, on in zip(trials, outputs, requests[headline], strict=True):
        answered.append(AnsweredTrial(trial, of.situation, on))
    drawn = drawn_trials(answered)

    return ScoredSet(
        figures=figures,
        methods=methods,
        drawn=drawn,
        central=central_trial(drawn, data.recordings),
        to_state_ms=event_times(risky).delay_ms,
    )


def _requests(
    data: DataSet,
    outputs: list[ModelOutputs],
    thresholds: Thresholds,
    baselines: Sequence[Baseline],
) -> dict[str, list[BoolArray]]:
    """Method -> [T] a recording, whether an act is requested."""
    requests = {}
    for name, permille in thresholds.confidences.items():
        requests[name] = requests_at(outputs, thresholds.rules, permille)

    by_name = {one.name: one for one in baselines}
    for matched in thresholds.baselines:
        # Detectors are computed again unless these recordings were matched on just now.
        # At the setting that was matched, which may come from other streams.
        on = by_name[matched.name].on(data.recordings)
        requests[matched.name] = on(matched.setting)

    return requests


def compared(
    methods: Mapping[str, Sequence[TrialOutcome]], thresholds: Thresholds
) -> dict[str, McNemar]:
    """McNemar's test of the headline against every baseline, event by event."""
    ours = detected(methods[thresholds.headline])
    tests = {}
    for baseline in thresholds.baselines:
        # Pairs of the same event: two recalls of one set are not independent.
        theirs = detected(methods[baseline.name])
        # Only events that one of both detected and the other did not tell them apart.
        tests[baseline.name] = mcnemar(ours, theirs)
    return tests


def _card(
    root: Path, data: DataSet, trials: Sequence[LabelledTrial], windows: WindowFigures
) -> SetCard:
    meta = read_json(root / "meta.json")
    seconds = 0.0
    events = 0
    onsets = []
    for one, trial in zip(data.recordings, trials, strict=True):
        # Each recording has a rate of its own, by which its samples count.
        seconds += one.counted_s(len(one.samples))
        events += len(one.events)
        onsets += trial.sources

    return SetCard(
        name=data.name,
        kind=data.kind,
        # A recorded set has none of these keys.
        made_from={name: meta[name] for name in MADE_FROM if name in meta},
        rate_hz=data.rate_hz,
        unit=data.unit,
        recordings=len(data.recordings),
        groups=len(data.groups()),
        group_kind=data.group_kind,
        minutes=seconds / 60.0,
        events=events,
        samples=data.notes.get("samples"),
        onsets_by=dict(sorted(Counter(onsets).items())),
        trained_on_recordings=windows.trained_on_recordings,
        caveat=data.caveat,
        timed=any(one.phases or one.events for one in data.recordings),
    )


class SetTimes(NamedTuple):
    """Times of a set's events: load onset to the first risky state, ms, and those of the alarms."""

    to_state_ms: list[float]
    of_events: EventTimes


@dataclass(frozen=True)
class Evaluation:
    """Everything the report shows. rows, mcnemar: of all sets together. model: its card.

    thresholds: of the first set where each set has its own. drawn, times, central: of pictures.
    """

    model: ModelCard
    thresholds: Thresholds
    seed: int
    sets: dict[str, SetFigures]
    rows: dict[str, MethodFigures]
    mcnemar: dict[str, McNemar]
    drawn: dict[str, list[AnsweredTrial]] = field(default_factory=dict)
    times: dict[str, SetTimes] = field(default_factory=dict)
    central: AnsweredTrial | None = None

    def to_json(self) -> Json:
        """figures.json; of one set alone, its window figures stand on top."""
        # As the file was before several sets could be evaluated: its readers find them there.
        top = {"model_id": self.model.model_id}
        if len(self.sets) == 1:
            top = next(iter(self.sets.values())).windows.to_json()

        # trained_on: None where its card does not say.
        model = {
            "model_id": self.model.model_id,
            "rate_hz": self.model.rate_hz,
            "unit": self.model.unit,
            "votes_for": list(self.model.classes),
            "trained_on": self.model.raw["training"].get("data"),
            "cannot_tell": self.model.not_learned,
        }
        return top | {
            "model": model,
            "thresholds": self.thresholds.to_json(),
            "seed": self.seed,
            "sets": {name: one.to_json() for name, one in self.sets.items()},
            "all": {"rows": _json(self.rows), "mcnemar": _json(self.mcnemar)},
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
            of_events = event_times([outcome.match for outcome in headline])
            times[name] = SetTimes(one.to_state_ms, of_events)

    return Evaluation(
        model=card,
        thresholds=thresholds,
        seed=seed,
        sets={name: one.figures for name, one in scored.items()},
        rows=figures_of_methods(methods, seed),
        mcnemar=compared(methods, thresholds),
        drawn=drawn,
        times=times,
        central=central,
    )
