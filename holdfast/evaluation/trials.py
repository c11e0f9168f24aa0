"""The table of trials that events, states, outcomes and pictures are counted from.

A row is a recording with the JSON of its truth. A simulated trial has a truth with one entry a
grasp: style, action, object, disturbance. A recorded one has labelled phases, or nothing. Voluntary
actions come from the labelled phases, which every trial has.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace
from itertools import chain
from pathlib import Path

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import (
    NOTHING,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
    Json,
)
from holdfast.core.trial_layout import (
    OTHER_ACTIONS,
    RISKY_ACTIONS,
    TACTILE,
    read_json,
    truth_path,
)
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase

DISTURBANCES = {"dFn": "grip_change", "dFt": "load_n", "dq": "motor_mm"}
"""Disturbance of a hold (grip, load, motor) -> the drawn parameter that is not 0 in it."""
MOST_TITLES = 5
"""Pictures of actions with other names than the thesis'."""
ROWS_DRAWN = 8
"""Trials in a picture of timelines."""


@dataclass(frozen=True)
class VoluntaryAction:
    """A voluntary hand-over or put-down, rows [first, stop).

    Its safe slips have nothing but holding between them.
    """

    first: int
    stop: int


@dataclass(frozen=True)
class LabelledTrial:
    """One recording without its samples. truth: its JSON as the scene writes it, {} without one."""

    recording: Recording
    truth: Json

    @property
    def grasps(self) -> list[Json]:
        """The truth of each grasp; that of a short trial is the truth of its only grasp."""
        grasps: list[Json] = self.truth.get("trials", [self.truth])
        return grasps

    @property
    def style(self) -> str:
        """The range of parameters of the one person who acts, or "" with several or none."""
        # A long stream may hold grasps of several people.
        styles = {str(grasp.get("style", "")) for grasp in self.grasps}
        return styles.pop() if len(styles) == 1 else ""

    @property
    def disturbances(self) -> list[str]:
        """dFn (grip), dFt (load) or dq (motor) of every hold that one of them disturbed."""
        found = []
        for grasp in self.grasps:
            # A hold without a disturbance has all three parameters at 0, or none of them.
            drawn = grasp.get("drawn", {})
            for name, parameter in DISTURBANCES.items():
                if drawn.get(parameter):
                    found.append(name)
                    break
        return found

    @property
    def sources(self) -> list[str]:
        """What gave each risky slip: scene, camera or key."""
        sources = []
        for phase in self.truth.get("phases", []):
            # Older truths do not name what gave a label.
            if phase.get("label") == SITUATIONS[RISKY_SLIP] and "provenance" in phase:
                sources.append(str(phase["provenance"]))
        return sources


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


def labelled_trials(root: Path, recordings: Sequence[Recording]) -> list[LabelledTrial]:
    """The table of trials of a folder."""
    trials = []
    for one in recordings:
        truth = read_json(truth_path(_csv(root, one.trial_id)))
        # The samples of a long set take much memory, and its figures need labels only.
        trials.append(LabelledTrial(without_samples(one), truth))
    return trials


def _csv(root: Path, trial_id: str) -> Path:
    """The CSV of a trial: tactile.csv in its folder (or in the root itself), or trial_n.csv."""
    # One recorded trial may be given by itself, and is then the root.
    for folder in (root, root / trial_id):
        if (folder / TACTILE).is_file():
            return folder / TACTILE
    return root / f"{trial_id}.csv"


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


def central_trial(
    drawn: Mapping[str, Sequence[AnsweredTrial]], recordings: Sequence[Recording]
) -> AnsweredTrial | None:
    """The trial that a report draws in full, with its samples: the first pull or fall drawn.

    Without such a trial it is the first of all, and None without a trial. No answer decides.
    """
    rows = list(chain.from_iterable(drawn.values()))
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
    for one in answered:
        # By action and object alone: no answer decides what is shown.
        by_title.setdefault(_title(one.trial.recording), []).append(one)
    # A fixed order, so that reports of two models can be read side by side.
    titles = ["pass", "pull", "fall", "put-down", "pass, full-bottle"]
    if not by_title.keys() & set(titles):
        # Recordings of a laboratory have actions of their own, or none that is named.
        titles = sorted(by_title)[:MOST_TITLES]

    drawn = {}
    for title in titles:
        if title in by_title:
            drawn[title or "trials"] = _interleaved(by_title[title])[:ROWS_DRAWN]
    return drawn


def _title(recording: Recording) -> str:
    if recording.action == "pass" and recording.object_name == "full-bottle":
        return "pass, full-bottle"
    return recording.action or ""


def _interleaved(trials: Sequence[AnsweredTrial]) -> list[AnsweredTrial]:
    """The first trial of every object before the second of any."""
    met: Counter[str | None] = Counter()
    rounds = []
    for one in trials:
        name = one.trial.recording.object_name
        # The round of a trial is how many of its object came before it, and itself.
        met[name] += 1
        rounds.append(met[name])

    # Stable: within a round the trials keep their order.
    order = np.argsort(rounds, kind="stable")
    return [trials[k] for k in order]
