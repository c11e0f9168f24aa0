"""What is known of a trial apart from its answers: grasps of its truth, voluntary actions.

A simulated trial has a truth with one entry a grasp: style, action, object, disturbance. A recorded
one has an empty grasp. Voluntary actions come from the labelled phases, which every trial has.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import NOTHING, RISKY_SLIP, SAFE_SLIP, BoolArray, Json
from holdfast.core.trial_layout import (
    OTHER_ACTIONS,
    RISKY_ACTIONS,
    read_json,
    truth_path,
)
from holdfast.training.recording import Recording
from holdfast.training.timeline import Phase

if TYPE_CHECKING:
    from holdfast.evaluation.model_outputs import ModelOutputs

DISTURBANCES = {"dFn": "grip_change", "dFt": "load_n", "dq": "motor_mm"}
"""Disturbance of a hold (grip, load, motor) -> the drawn parameter that is not 0 in it."""
MOST_TITLES = 5
"""Pictures of actions with other names than the thesis'."""
ROWS_DRAWN = 8
"""Trials in a picture of timelines."""


@dataclass(frozen=True)
class Grasp:
    """One simulated grasp. truth: its JSON as the scene writes it, empty without a truth."""

    truth: Json

    @property
    def style(self) -> str:
        """The range of parameters of the person who acts, or ""."""
        return str(self.truth.get("style", ""))

    @property
    def disturbance(self) -> str | None:
        """dFn (grip), dFt (load) or dq (motor), where one of them disturbed the hold."""
        # A hold without a disturbance has all three parameters at 0, or none of them.
        drawn = self.truth.get("drawn", {})
        for name, parameter in DISTURBANCES.items():
            if drawn.get(parameter):
                return name
        return None


@dataclass(frozen=True)
class VoluntaryAction:
    """A voluntary hand-over or put-down, rows [first, stop).

    Its safe slips have nothing but holding between them.
    """

    first: int
    stop: int


@dataclass(frozen=True)
class LabelledTrial:
    """One recording without its samples and its grasps by the truth."""

    recording: Recording
    grasps: tuple[Grasp, ...]


@dataclass(frozen=True)
class AnsweredTrial:
    """A trial to be drawn: its truth, the state and the request to act at every sample [T]."""

    trial: LabelledTrial
    situation: npt.NDArray[np.int64]
    requests: BoolArray


def without_samples(recording: Recording) -> Recording:
    """The same recording, as light as its labels."""
    no_samples = recording.samples[:0]
    no_valid = recording.valid[:0]
    return replace(recording, samples=no_samples, valid=no_valid)


def grasps_of(root: Path, recordings: Sequence[Recording]) -> list[tuple[Grasp, ...]]:
    """The grasps of every recording of a folder; one empty grasp where there is no truth."""
    grasps = []
    for recording in recordings:
        truth = read_json(truth_path(root / f"{recording.trial_id}.csv"))
        # A long stream has several grasps; the truth of a short one is that of its only grasp.
        of_each = truth.get("trials", [truth])
        grasps.append(tuple(map(Grasp, of_each)))
    return grasps


def style_of(grasps: tuple[Grasp, ...]) -> str:
    """The one style of a recording, or "" where there are several or none."""
    # A long stream may hold grasps of several people.
    styles = {grasp.style for grasp in grasps}
    return styles.pop() if len(styles) == 1 else ""


def voluntary_actions(recording: Recording) -> list[VoluntaryAction]:
    """The voluntary actions of a recording, in order.

    Actions within a grip that fails, and the end of a hold, are none.
    """
    # A hold ends by opening the hand, which is no hand-over; so do everyday actions.
    if recording.action in OTHER_ACTIONS:
        return []
    actions = actions_of(recording.phases)
    # A grip that fails slips safely for a moment on its way.
    return [one for one in actions if not _within_an_event(one, recording)]


def _within_an_event(action: VoluntaryAction, recording: Recording) -> bool:
    rate_hz = recording.rate_hz
    for event in recording.events:
        first = event.onset_s * rate_hz
        stop = event.end_s * rate_hz
        # They touch in one sample where one follows on the other.
        if first < action.stop - 1 and action.first < stop - 1:
            return True
    return False


def actions_of(phases: Sequence[Phase]) -> list[VoluntaryAction]:
    """Safe slips, those with nothing but holding between them as one.

    >>> actions_of([Phase(0, 5, 1), Phase(5, 8, 2), Phase(8, 10, 1), Phase(10, 12, 2)])
    [VoluntaryAction(first=5, stop=12)]
    """
    actions: list[VoluntaryAction] = []
    continues = False
    for phase in phases:
        if phase.situation == SAFE_SLIP and continues:
            # A put-down slips more than once while the fingers open.
            first = actions[-1].first
            actions[-1] = VoluntaryAction(first, phase.stop)
        elif phase.situation == SAFE_SLIP:
            actions.append(VoluntaryAction(phase.first, phase.stop))
            continues = True
        # Once the object is gone, or lost, the next safe slip is another action.
        elif phase.situation in (NOTHING, RISKY_SLIP):
            continues = False

    return actions


def answered_trials(
    trials: Sequence[LabelledTrial],
    outputs: Sequence[ModelOutputs],
    requests: Sequence[BoolArray],
) -> list[AnsweredTrial]:
    """Every trial with its answers."""
    answered = []
    for trial, of, on in zip(trials, outputs, requests, strict=True):
        answered.append(AnsweredTrial(trial, of.situation, on))
    return answered


def central_trial(
    drawn: Mapping[str, Sequence[AnsweredTrial]], recordings: Sequence[Recording]
) -> AnsweredTrial | None:
    """The trial that a report draws in full, with its samples: the first pull or fall drawn.

    Without such a trial it is the first of all, and None without a trial. No answer decides.
    """
    rows = [one for of_title in drawn.values() for one in of_title]
    slips = [one for one in rows if one.trial.recording.action in RISKY_ACTIONS]
    if not rows:
        return None

    first = (slips or rows)[0]
    by_id = {one.trial_id: one for one in recordings}
    whole = by_id[first.trial.recording.trial_id]
    return replace(first, trial=replace(first.trial, recording=whole))


def drawn_trials(answered: Sequence[AnsweredTrial]) -> dict[str, list[AnsweredTrial]]:
    """Title -> the trials that a report draws; no title without a trial.

    They are the first of each action, chosen before any answer is known. Hand-overs of a full
    bottle, the heaviest object, have a picture of their own.
    """
    by_title: dict[str, list[AnsweredTrial]] = {}
    # A fixed order, so that reports of two models can be read side by side.
    titles = ["pass", "pull", "fall", "put-down", "pass, full-bottle"]
    found = {_title(one.trial.recording) for one in answered}
    if not found.intersection(titles):
        # Recordings of a laboratory have actions of their own, or none that is named.
        titles = sorted(found)[:MOST_TITLES]

    for title in titles:
        # By action and object alone: no answer decides what is shown.
        rows = [one for one in answered if _title(one.trial.recording) == title]
        if rows:
            by_title[title or "trials"] = _interleaved(rows)[:ROWS_DRAWN]

    return by_title


def _title(recording: Recording) -> str:
    if recording.action == "pass" and recording.object_name == "full-bottle":
        return "pass, full-bottle"
    return recording.action or ""


def _interleaved(trials: Sequence[AnsweredTrial]) -> list[AnsweredTrial]:
    """The first trial of every object before the second of any."""
    count: dict[str | None, int] = {}
    rounds = []
    for one in trials:
        name = one.trial.recording.object_name
        # The round of a trial is how many of its object came before it, and itself.
        count[name] = count.get(name, 0) + 1
        rounds.append(count[name])

    # Stable: within a round the trials keep their order.
    order = np.argsort(rounds, kind="stable")
    return [trials[k] for k in order]
