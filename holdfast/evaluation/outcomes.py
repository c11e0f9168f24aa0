"""Whether the action of a trial was recognised, and one person's figures.

A pull or fall is recognised where an act was requested in it and not before. A hand-over or
put-down is recognised where the state was safe_slip in it and no act was requested.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from holdfast.core.contract import SAFE_SLIP, SITUATIONS, Json
from holdfast.core.trial_layout import (
    EVENTS,
    RISKY_ACTIONS,
    TACTILE,
    read_events,
    read_json,
    truth_path,
)
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.evaluation.alarms import EventMatch, match_alarms
from holdfast.evaluation.model_outputs import run_model
from holdfast.evaluation.statistics import Spread, spread
from holdfast.evaluation.thresholds import requests_of
from holdfast.evaluation.trials import (
    AnsweredTrial,
    LabelledTrial,
    answered_trials,
    central_trial,
    voluntary_actions,
    without_samples,
)
from holdfast.training.datasets import load
from holdfast.training.recording import Recording

ACTIONS = ("pass", "pull", "fall", "put-down")
"""Actions in which there is something to recognise."""
ONSETS = ("load_onset", "incipient_slip")
"""Marks of which either begins the action of a trial."""
SLIPS = SITUATIONS[2:]
"""Labels of a slip, safe or risky."""


def recognised(answered: AnsweredTrial) -> bool | None:
    """Whether a trial's action was; None where it did not happen (a pull that did not slip)."""
    recording = answered.trial.recording
    requests = answered.requests
    if recording.action in RISKY_ACTIONS:
        match = match_alarms(recording, requests)
        # Without a slip there was nothing to recognise.
        if not match.outcomes:
            return None
        # One alarm too many is no recognition: the hand would have tightened without a cause.
        found = all(outcome.alarm_s is not None for outcome in match.outcomes)
        return found and not match.false_s

    actions = voluntary_actions(recording)
    if recording.action not in ACTIONS or not actions:
        return None
    for action in actions:
        during = answered.situation[action.first : action.stop]
        # One sample is enough here: a state that comes late in the action was still recognised.
        if not np.any(during == SAFE_SLIP):
            return False

    # A hand that tightens in a hand-over has not understood it, whatever the state was.
    return not requests.any()


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

    def to_json(self) -> Json:
        """As it stands in report.json."""
        return asdict(self) | {"false_per_min": self.false_per_min}


@dataclass(frozen=True)
class ParticipantFigures:
    """All figures of one person's recordings. labels_by: provenance -> trials whose slip it gives.

    unlabelled: why an action has no label -> its trials.

    cells: each action with each object; actions: with all objects. drawn: action -> its trials.
    """

    model_id: str
    kind: str
    trials: int
    labels_by: dict[str, int]
    caveat: str
    whole: ActionFigures
    actions: list[ActionFigures]
    cells: list[ActionFigures]
    unlabelled: dict[str, int]
    drawn: dict[str, list[AnsweredTrial]]
    central: AnsweredTrial | None

    def to_json(self) -> Json:
        """As it stands in report.json, without the timelines."""
        return {
            "model_id": self.model_id,
            "kind": self.kind,
            "trials": self.trials,
            "labels_by": self.labels_by,
            "unlabelled": self.unlabelled,
            "caveat": self.caveat,
            "all": self.whole.to_json(),
            "actions": [one.to_json() for one in self.actions],
            "cells": [one.to_json() for one in self.cells],
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
    """Figures of the kept trials in one person's folder.

    An action without a label counts nowhere: whether it was recognised is then not known. An alarm
    counts as false in every other trial. Raises a DataError: no trial, no mass of an object, or a
    unit or rate that does not fit the model.
    """
    data = load(folder, channels=model.card.n_channels, windows="none")
    # As the hand runs it, with the confidence of the model card: nothing is chosen here.
    outputs = run_model(model, data)
    rules = model.card.decision
    requests = requests_of(outputs, rules, rules.min_risky_permille)
    # Recorded trials have no truth of a scene, so no grasps either.
    trials = [LabelledTrial(without_samples(one), ()) for one in data.recordings]

    every = []
    drawn: dict[str, list[AnsweredTrial]] = {}
    by_action: dict[str, list[_Judged]] = {}
    by_cell: dict[tuple[str, str], list[_Judged]] = {}
    for one in answered_trials(trials, outputs, requests):
        recording = one.trial.recording
        match = match_alarms(recording, one.requests)
        # Matched once, for all the tables that the trial is counted in.
        judged = _Judged(recording, recognised(one), match)
        every.append(judged)

        name = recording.object_name or ""
        action = recording.action or ""
        # The timelines are kept by action, because the report draws one picture for each.
        drawn.setdefault(action, []).append(one)
        by_action.setdefault(action, []).append(judged)
        by_cell.setdefault((name, action), []).append(judged)

    in_order = sorted(drawn)

    return ParticipantFigures(
        model_id=model.card.model_id,
        kind=data.kind,
        trials=len(trials),
        labels_by=_labels_by(folder, data.recordings),
        unlabelled=_unlabelled(folder, every),
        caveat=data.caveat,
        whole=_figures("", "", every),
        actions=[_figures("", action, by_action[action]) for action in in_order],
        cells=[_figures(name, action, of) for (name, action), of in by_cell.items()],
        drawn={action: drawn[action] for action in in_order},
        central=central_trial(drawn, data.recordings),
    )


def _figures(name: str, action: str, judged: Sequence[_Judged]) -> ActionFigures:
    """Of one cell; "": of all objects, or of all actions."""
    right = [one.right for one in judged if one.right is not None]
    false = 0
    minutes = 0.0
    delays_ms = []
    for one in judged:
        # A pull without a label may have slipped: its alarm may be right, so it is not judged.
        if not one.judges_alarms:
            continue
        false += len(one.match.false_s)
        minutes += one.match.minutes
        for outcome in one.match.outcomes:
            if outcome.delay_s is not None:
                delays_ms.append(1e3 * outcome.delay_s)

    return ActionFigures(
        object=name,
        action=action,
        trials=len(judged),
        # Recognised of these only: without a label nothing was judged.
        labelled=len(right),
        recognised=sum(right),
        false_alarms=false,
        minutes=minutes,
        delay_ms=spread(delays_ms),
    )


def _labels_by(folder: Path, recordings: Sequence[Recording]) -> dict[str, int]:
    """Provenance (scene, camera, key) -> number of trials whose slip, risky or safe, it gave."""
    count: Counter[str] = Counter()
    for recording in recordings:
        truth = read_json(truth_path(folder / recording.trial_id / TACTILE))
        sources = set()
        for phase in truth.get("phases", []):
            # Slips are the labels that decide the figures, so their provenance is reported.
            if phase.get("label") in SLIPS:
                # A put-down slips more than once, and is still one trial.
                sources.add(str(phase.get("provenance")))
        count.update(sources)
    return dict(sorted(count.items()))


def _unlabelled(folder: Path, judged: Sequence[_Judged]) -> dict[str, int]:
    """Why a trial's action has no label -> number of trials."""
    reasons = Counter(
        _why_no_label(folder / one.recording.trial_id, one.recording.action)
        for one in judged
        if one.right is None
    )
    return dict(sorted(reasons.items()))


def _onsets(trial: Path) -> list[Json]:
    """Events that begin an action: marks, and what a camera wrote."""
    events = read_events(trial / EVENTS)
    return [one for one in events if one.get("mark") in ONSETS or "gross_s" in one]


def _why_no_label(trial: Path, action: str | None) -> str:
    if action not in ACTIONS:
        return "nothing to recognise in its action"
    phases = read_json(truth_path(trial / TACTILE)).get("phases", [])
    if any(phase.get("provenance") == "scene" for phase in phases):
        return "the object did not slip"
    sources = {event.get("provenance") for event in _onsets(trial)}
    if sources & {"key", "camera"}:
        return "marked, but outside the grip, or the grip has no beginning or end"
    return "no key l, and no camera"
