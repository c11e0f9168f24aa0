"""Whether the action of a trial was recognised, and one person's figures.

A pull or fall is recognised where an act was requested in it and not before. A hand-over or
put-down is recognised where the state was safe_slip in it and no act was requested.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from holdfast.core.contract import SAFE_SLIP, SITUATIONS, Json
from holdfast.core.trial_layout import EVENTS, RISKY_ACTIONS, read_events
from holdfast.edge_runtime.engine import OpenedModel
from holdfast.evaluation.alarms import event_times, match_alarms
from holdfast.evaluation.baselines import requests_of
from holdfast.evaluation.model_outputs import run_model
from holdfast.evaluation.statistics import Spread, spread
from holdfast.evaluation.trials import (
    AnsweredTrial,
    LabelledTrial,
    central_trial,
    counted,
    labelled_trials,
    voluntary_actions,
)
from holdfast.training.datasets import load

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
    trials = labelled_trials(folder, data.recordings)

    rows = []
    by_action: dict[str, list[AnsweredTrial]] = {}
    by_cell: dict[tuple[str, str], list[AnsweredTrial]] = {}
    labels_by: list[str] = []
    for trial, of, on in zip(trials, outputs, requests, strict=True):
        one = AnsweredTrial(trial, of.situation, on)
        rows.append(one)
        action = trial.recording.action or ""
        by_action.setdefault(action, []).append(one)
        by_cell.setdefault((trial.recording.object_name or "", action), []).append(one)
        # A put-down slips more than once, and is still one trial.
        labels_by += set(trial.sources(SLIPS))

    # The report draws one picture for each action.
    drawn = {action: by_action[action] for action in sorted(by_action)}
    return ParticipantFigures(
        model_id=model.card.model_id,
        kind=data.kind,
        trials=len(trials),
        labels_by=counted(labels_by),
        unlabelled=_unlabelled(folder, rows),
        caveat=data.caveat,
        whole=_figures("", "", rows),
        actions=[_figures("", action, of_one) for action, of_one in drawn.items()],
        cells=[_figures(*cell, of_one) for cell, of_one in by_cell.items()],
        drawn=drawn,
        central=central_trial(drawn, data.recordings),
    )


def _figures(name: str, action: str, trials: Sequence[AnsweredTrial]) -> ActionFigures:
    """Of one cell; "": of all objects, or of all actions."""
    right = []
    judged = []
    false_alarms = 0
    minutes = 0.0
    for one in trials:
        was_right = recognised(one)
        if was_right is not None:
            right.append(was_right)
        recording = one.trial.recording
        # A pull without a label may have slipped: its alarm may be right, so it is not judged.
        if recording.action not in RISKY_ACTIONS or recording.events:
            match = match_alarms(recording, one.requests)
            judged.append(match)
            false_alarms += len(match.false_s)
            minutes += match.minutes

    return ActionFigures(
        object=name,
        action=action,
        trials=len(trials),
        # Recognised of these only: without a label nothing was judged.
        labelled=len(right),
        recognised=sum(right),
        false_alarms=false_alarms,
        minutes=minutes,
        delay_ms=spread(event_times(judged).delay_ms),
    )


def _unlabelled(folder: Path, trials: Sequence[AnsweredTrial]) -> dict[str, int]:
    """Why a trial's action has no label -> number of trials."""
    reasons = []
    for one in trials:
        if recognised(one) is None:
            reasons.append(_why_no_label(folder, one.trial))
    return counted(reasons)


def _why_no_label(folder: Path, trial: LabelledTrial) -> str:
    if trial.recording.action not in ACTIONS:
        return "nothing to recognise in its action"
    if "scene" in trial.sources(SITUATIONS):
        return "the object did not slip"
    sources = set()
    for event in read_events(folder / trial.recording.trial_id / EVENTS):
        # A mark begins an action, and so does what a camera wrote.
        if event.get("mark") in ONSETS or "gross_s" in event:
            sources.add(event.get("provenance"))
    if sources & {"key", "camera"}:
        return "marked, but outside the grip, or the grip has no beginning or end"
    return "no key l, and no camera"
