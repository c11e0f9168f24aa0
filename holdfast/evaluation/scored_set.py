"""One set scored: what every method requested on it, and all figures of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from holdfast.core.contract import BoolArray, Json, untold_of
from holdfast.core.trial_layout import read_json
from holdfast.edge_runtime.model_file import ModelCard
from holdfast.evaluation.baselines import Baseline
from holdfast.evaluation.methods import (
    MethodFigures,
    MethodResult,
    figures_of_methods,
    method_result,
)
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.onsets import onsets_by
from holdfast.evaluation.states import StateFigures, risky_states, state_figures
from holdfast.evaluation.statistics import McNemar, mcnemar
from holdfast.evaluation.thresholds import Thresholds, requests_of
from holdfast.evaluation.trials import (
    AnsweredTrial,
    LabelledTrial,
    answered_trials,
    central_trial,
    drawn_trials,
    grasps_of,
    without_samples,
)
from holdfast.evaluation.window_scores import WindowFigures
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import DataSet

MADE_FROM = ("title", "card_sha256", "seed", "effects")
"""Keys of a set's meta.json that its figures repeat."""


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
        fields = asdict(self)
        # The keys of made_from stand among the others, after name and kind.
        made_from = fields.pop("made_from")
        # Readers see what a set is before its counts.
        first = {"name": fields.pop("name"), "kind": fields.pop("kind")}
        return first | made_from | fields


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
            "rows": {name: asdict(one) for name, one in self.rows.items()},
            "states": asdict(self.states),
            "mcnemar": {name: asdict(one) for name, one in self.mcnemar.items()},
        }
        if self.thresholds:
            figures["thresholds"] = self.thresholds.to_json()
        return figures


@dataclass(frozen=True)
class ScoredSet:
    """A set with what the figures of all sets together need.

    drawn: trials of a report, by title. central: one of them, with its samples.
    to_state_ms: load onset to the first risky state.
    """

    figures: SetFigures
    trials: list[LabelledTrial]
    methods: dict[str, MethodResult]
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
    trials = _labelled_trials(root, data)
    requests = _requests(data, outputs, thresholds, baselines)
    methods = {}
    for name, on in requests.items():
        methods[name] = method_result(trials, on)

    headline = thresholds.headline
    permille = thresholds.confidences[headline]
    # States are shown at the confidence of the headline, and so fit its alarms.
    untold = untold_of(card.raw)
    states = state_figures(outputs, permille, seed, untold)
    part(0.5)

    figures = SetFigures(
        card=_card(root, data, windows),
        windows=windows,
        rows=figures_of_methods(methods, trials, seed),
        states=states,
        mcnemar=compared(methods, thresholds),
        # Thresholds that were chosen elsewhere are the same for all sets and stand on top.
        thresholds=thresholds if thresholds.chosen is None else None,
    )

    # At the headline's confidence: the pictures show what the table counts.
    answered = answered_trials(trials, outputs, requests[headline])
    drawn = drawn_trials(answered)

    return ScoredSet(
        figures=figures,
        trials=trials,
        methods=methods,
        drawn=drawn,
        central=central_trial(drawn, data.recordings),
        to_state_ms=_to_state_ms(outputs, permille),
    )


def _labelled_trials(root: Path, data: DataSet) -> list[LabelledTrial]:
    grasps = grasps_of(root, data.recordings)
    trials = []
    for one, held in zip(data.recordings, grasps, strict=True):
        # The samples of a long set take much memory, and its figures need labels only.
        trials.append(LabelledTrial(without_samples(one), held))
    return trials


def _requests(
    data: DataSet,
    outputs: list[ModelOutputs],
    thresholds: Thresholds,
    baselines: Sequence[Baseline],
) -> dict[str, list[BoolArray]]:
    """Method -> [T] a recording, whether an act is requested."""
    requests = {}
    for name, permille in thresholds.confidences.items():
        requests[name] = requests_of(outputs, thresholds.rules, permille)

    by_name = {one.name: one for one in baselines}
    for matched in thresholds.baselines:
        # Detectors are computed again unless these recordings were matched on just now.
        # At the setting that was matched, which may come from other streams.
        on = by_name[matched.name].on(data.recordings)
        requests[matched.name] = on(matched.setting)

    return requests


def _to_state_ms(outputs: list[ModelOutputs], permille: int) -> list[float]:
    times_ms = []
    for match in risky_states(outputs, permille):
        for outcome in match.outcomes:
            if outcome.delay_s is not None:
                times_ms.append(1e3 * outcome.delay_s)
    return times_ms


def compared(
    methods: dict[str, MethodResult], thresholds: Thresholds
) -> dict[str, McNemar]:
    """McNemar's test of the headline against every baseline, event by event."""
    ours = methods[thresholds.headline].detected()
    tests = {}
    for baseline in thresholds.baselines:
        # Pairs of the same event: two recalls of one set are not independent.
        theirs = methods[baseline.name].detected()
        # Only events that one of both detected and the other did not tell them apart.
        tests[baseline.name] = mcnemar(ours, theirs)
    return tests


def _card(root: Path, data: DataSet, windows: WindowFigures) -> SetCard:
    meta = read_json(root / "meta.json")
    # A recorded set has none of these keys.
    made_from = {}
    for key, value in meta.items():
        if key in MADE_FROM:
            made_from[key] = value

    seconds = 0.0
    events = 0
    for one in data.recordings:
        # Each recording has a rate of its own, by which its samples count.
        seconds += len(one.samples) / one.rate_hz
        events += len(one.events)

    return SetCard(
        name=data.name,
        kind=data.kind,
        made_from=made_from,
        rate_hz=data.rate_hz,
        unit=data.unit,
        recordings=len(data.recordings),
        groups=len(data.groups()),
        group_kind=data.group_kind,
        minutes=seconds / 60.0,
        events=events,
        samples=data.notes.get("samples"),
        onsets_by=onsets_by(root, data.recordings),
        trained_on_recordings=windows.trained_on_recordings,
        caveat=data.caveat,
        timed=any(one.phases or one.events for one in data.recordings),
    )
