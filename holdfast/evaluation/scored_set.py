"""One set scored: what every method requested on it, and all figures of that."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from holdfast.core.contract import BoolArray
from holdfast.core.reading import Json
from holdfast.core.trial_layout import read_json
from holdfast.evaluation.baselines import Baseline
from holdfast.evaluation.camera import onsets_by, seen_beside
from holdfast.evaluation.closing_hand import (
    ClosingModel,
    Drop,
    closing_model,
    drop_of,
    droppable,
)
from holdfast.evaluation.methods import (
    LabelledTrial,
    MethodFigures,
    MethodResult,
    figures_of_methods,
    method_result,
    without_samples,
)
from holdfast.evaluation.model_outputs import ModelOutputs
from holdfast.evaluation.outcomes import JudgedTrial, judged_trials
from holdfast.evaluation.states import StateFigures, risky_states, state_figures
from holdfast.evaluation.statistics import McNemar, mcnemar
from holdfast.evaluation.stream_pictures import ShownTrial, shown_trials
from holdfast.evaluation.thresholds import Thresholds, requests_of
from holdfast.evaluation.truths import grasp_of, grasps_beside
from holdfast.evaluation.window_scores import WindowFigures
from holdfast.training.progress import Part, ignored
from holdfast.training.recording import DataSet

MADE_FROM = ("title", "card_sha256", "seed", "effects")
"""Keys of a set's meta.json that its figures repeat."""


@dataclass(frozen=True)
class SetCard:
    """What a set is. made_from: those of MADE_FROM that its meta.json has."""

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

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        fields = asdict(self)
        made_from = fields.pop("made_from")
        return {
            "name": fields.pop("name"),
            "kind": fields.pop("kind"),
            **made_from,
            **fields,
        }


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
    closing: ClosingModel | None
    thresholds: Thresholds | None

    def to_json(self) -> Json:
        """As it stands in figures.json."""
        figures = {
            "data": self.card.to_json(),
            "windows": self.windows.to_json(),
            "rows": {name: asdict(one) for name, one in self.rows.items()},
            "states": asdict(self.states),
            "mcnemar": {name: asdict(one) for name, one in self.mcnemar.items()},
            "closing": None if self.closing is None else asdict(self.closing),
        }
        return figures | (
            {"thresholds": self.thresholds.to_json()} if self.thresholds else {}
        )


@dataclass(frozen=True)
class ScoredSet:
    """A set with what the figures of all sets together need. to_state_ms: load onset to risky."""

    figures: SetFigures
    trials: list[LabelledTrial]
    methods: dict[str, MethodResult]
    drops: list[Drop | None]
    judged: list[JudgedTrial]
    shown: dict[str, list[ShownTrial]]
    to_state_ms: list[float]


def score_set(
    root: Path,
    data: DataSet,
    outputs: list[ModelOutputs],
    thresholds: Thresholds,
    baselines: Sequence[Baseline],
    windows: WindowFigures,
    seed: int,
    part: Part = ignored,
) -> ScoredSet:
    """Score every method on a set. outputs: of the model, for each of the set's recordings."""
    trials = _labelled(root, data)
    requests = _requests(data, outputs, thresholds, baselines)
    methods = {name: method_result(trials, on) for name, on in requests.items()}
    drops = [
        drop_of(event, grasp_of(event, one.grasps))
        for one in trials
        for event in one.recording.events
    ]
    headline, permille = (
        thresholds.headline,
        thresholds.confidences[thresholds.headline],
    )
    states = state_figures(outputs, permille, _heavy(data), seed)
    part(0.5)
    figures = SetFigures(
        _card(root, data, windows),
        windows,
        _rows(methods, trials, drops, seed),
        states,
        compared(methods, thresholds),
        closing_model(drops, methods[headline].delays_s()),
        thresholds if thresholds.chosen is None else None,
    )
    return ScoredSet(
        figures,
        trials,
        methods,
        drops,
        judged_trials(trials, outputs, requests[headline]),
        shown_trials(trials, outputs, requests[headline]),
        _to_state_ms(outputs, permille),
    )


def _to_state_ms(outputs: list[ModelOutputs], permille: int) -> list[float]:
    outcomes = [o for one in risky_states(outputs, permille) for o in one.outcomes]
    return [1e3 * o.delay_s for o in outcomes if o.delay_s is not None]


def _labelled(root: Path, data: DataSet) -> list[LabelledTrial]:
    grasps, seen = (
        grasps_beside(root, data.recordings),
        seen_beside(root, data.recordings),
    )
    return [
        LabelledTrial(without_samples(one), held, slips)
        for one, held, slips in zip(data.recordings, grasps, seen, strict=True)
    ]


def _requests(
    data: DataSet,
    outputs: list[ModelOutputs],
    thresholds: Thresholds,
    baselines: Sequence[Baseline],
) -> dict[str, list[BoolArray]]:
    """Method -> [T] a recording, whether an act is requested."""
    requests = {
        name: requests_of(outputs, thresholds.rules, permille)
        for name, permille in thresholds.confidences.items()
    }
    by_name = {one.name: one for one in baselines}
    return requests | {
        one.name: by_name[one.name].on(data.recordings)(one.setting)
        for one in thresholds.baselines
    }


def _rows(
    methods: dict[str, MethodResult],
    trials: Sequence[LabelledTrial],
    drops: Sequence[Drop | None],
    seed: int,
) -> dict[str, MethodFigures]:
    return figures_of_methods(methods, trials, droppable(drops), seed)


def compared(
    methods: dict[str, MethodResult], thresholds: Thresholds
) -> dict[str, McNemar]:
    """McNemar's test of the headline against every baseline, event by event."""
    ours = methods[thresholds.headline].detected()
    names = [one.name for one in thresholds.baselines]
    return {name: mcnemar(ours, methods[name].detected()) for name in names}


def _heavy(data: DataSet) -> list[bool | None]:
    """Whether each recording's object is heavy; None without an object or a window."""
    heavy: list[bool | None] = [None] * len(data.recordings)
    if "classes" in data.tasks:
        task = data.tasks["classes"]
        for trial, label in zip(task.trial.tolist(), task.label.tolist(), strict=True):
            if data.recordings[trial].object_name is not None:
                heavy[trial] = bool(label % 2)
    return heavy


def _card(root: Path, data: DataSet, windows: WindowFigures) -> SetCard:
    meta = read_json(root / "meta.json")
    return SetCard(
        name=data.name,
        kind=data.kind,
        made_from={key: value for key, value in meta.items() if key in MADE_FROM},
        rate_hz=data.rate_hz,
        unit=data.unit,
        recordings=len(data.recordings),
        groups=len(data.groups()),
        group_kind=data.group_kind,
        minutes=sum(len(one.samples) / one.rate_hz for one in data.recordings) / 60.0,
        events=sum(len(one.events) for one in data.recordings),
        samples=data.notes.get("samples"),
        onsets_by=onsets_by(root, data.recordings),
        trained_on_recordings=windows.trained_on_recordings,
        caveat=data.caveat,
    )
