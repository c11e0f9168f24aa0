"""What a model answered in one person's recordings: recall by action, false alarms, timelines.

A pull or fall is recognised where an act was requested in it and not before; a hand-over or
put-down where the state was safe_slip in it and no act was requested (evaluation/figures.py). An
action without a label counts nowhere: whether it was recognised is then not known. An alarm counts
as false in every other trial.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

from holdfast.core.contract import SITUATIONS, BoolArray
from holdfast.core.reading import Json
from holdfast.core.trial_layout import RISKY_ACTIONS, TACTILE, read_json, truth_path
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.evaluation.event_scores import EventMatch, match_alarms
from holdfast.evaluation.methods import LabelledTrial, without_samples
from holdfast.evaluation.model_outputs import ModelOutputs, run_model
from holdfast.evaluation.outcomes import recognised
from holdfast.evaluation.statistics import Spread, spread
from holdfast.evaluation.stream_pictures import ShownTrial
from holdfast.evaluation.thresholds import requests_of
from holdfast.training.datasets import load
from holdfast.training.recording import Recording

SLIPS = SITUATIONS[2:]


@dataclass(frozen=True)
class ActionFigures:
    """One action with one object, or with all (object ""). recognised: of `labelled` trials.

    delay_ms: load onset to the request to act, of pulls and falls. minutes, false_alarms: of trials
    in which an alarm can be judged.
    """

    object: str
    action: str
    trials: int
    labelled: int
    recognised: int
    false_alarms: int
    minutes: float
    delay_ms: Spread | None

    @property
    def false_per_min(self) -> float | None:
        """False alarms a minute; None without a minute that can be judged."""
        return self.false_alarms / self.minutes if self.minutes else None


@dataclass(frozen=True)
class ParticipantFigures:
    """All figures of one person's recordings. labels_by: provenance -> labels of slips.

    cells: each action with each object; actions: with all objects. shown: action -> its trials.
    """

    model_id: str
    kind: str
    trials: int
    labels_by: dict[str, int]
    caveat: str
    whole: ActionFigures
    actions: list[ActionFigures]
    cells: list[ActionFigures]
    shown: dict[str, list[ShownTrial]]

    def to_json(self) -> Json:
        """As it stands in report.json, without the timelines."""
        return {
            "model_id": self.model_id,
            "kind": self.kind,
            "trials": self.trials,
            "labels_by": self.labels_by,
            "caveat": self.caveat,
            "all": _json(self.whole),
            "actions": [_json(one) for one in self.actions],
            "cells": [_json(one) for one in self.cells],
        }


@dataclass(frozen=True)
class _Judged:
    """A trial: whether its action was recognised (None: not known), and its alarms."""

    recording: Recording
    right: bool | None
    match: EventMatch

    @property
    def judges_alarms(self) -> bool:
        """Whether an alarm in it can be false: in a pull without a label it may be right."""
        return self.recording.action not in RISKY_ACTIONS or bool(self.recording.events)


def participant_figures(model: OpenedModel, folder: Path) -> ParticipantFigures:
    """Figures of the kept trials in one person's folder. Raises a DataError.

    No trial, no mass of an object, or a unit or rate that does not fit the model.
    """
    data = load(folder, channels=model.card.n_channels, windows="none")
    outputs = run_model(model, data)
    rules = model.card.decision
    requests = requests_of(outputs, rules, rules.min_risky_permille)
    trials = [LabelledTrial(without_samples(one), ()) for one in data.recordings]
    judged = [
        _Judged(one.recording, recognised(one, of, on), match_alarms(one.recording, on))
        for one, of, on in zip(trials, outputs, requests, strict=True)
    ]
    pairs = dict.fromkeys(
        (one.object_name or "", one.action or "") for one in data.recordings
    )
    actions = sorted({action for _, action in pairs})
    return ParticipantFigures(
        model.card.model_id,
        data.kind,
        len(trials),
        _labels_by(folder, data.recordings),
        data.caveat,
        _figures(judged),
        [_figures(judged, action=action) for action in actions],
        [_figures(judged, thing, action) for thing, action in pairs],
        _shown(trials, outputs, requests, actions),
    )


def _figures(
    judged: Sequence[_Judged], thing: str = "", action: str = ""
) -> ActionFigures:
    """Of one cell; "": of all objects, or of all actions."""
    here = [
        one
        for one in judged
        if thing in ("", one.recording.object_name)
        and action in ("", one.recording.action)
    ]
    judging = [one.match for one in here if one.judges_alarms]
    known = [one.right for one in here if one.right is not None]
    delays_s = [o.delay_s for one in judging for o in one.outcomes]
    return ActionFigures(
        thing,
        action,
        len(here),
        len(known),
        sum(known),
        sum(len(one.false_s) for one in judging),
        sum(one.minutes for one in judging),
        spread([1e3 * delay_s for delay_s in delays_s if delay_s is not None]),
    )


def _shown(
    trials: Sequence[LabelledTrial],
    outputs: Sequence[ModelOutputs],
    requests: Sequence[BoolArray],
    actions: Sequence[str],
) -> dict[str, list[ShownTrial]]:
    """Every trial, by action."""
    every = [
        ShownTrial(trial, of.situation, on)
        for trial, of, on in zip(trials, outputs, requests, strict=True)
    ]
    return {
        action: [one for one in every if one.trial.recording.action == action]
        for action in actions
    }


def _labels_by(folder: Path, recordings: Sequence[Recording]) -> dict[str, int]:
    """Provenance (scene, camera, key) -> number of slips, risky or safe, whose label it gave."""
    truths = [
        read_json(truth_path(folder / one.trial_id / TACTILE)) for one in recordings
    ]
    given = [
        str(phase.get("provenance"))
        for truth in truths
        for phase in truth.get("phases", [])
        if phase.get("label") in SLIPS
    ]
    return dict(sorted(Counter(given).items()))


def _json(of: ActionFigures) -> Json:
    return asdict(of) | {"false_per_min": of.false_per_min}
