"""Adapting to people of human_slip_uskin: on their familiarization trials, scored on the rest.

The base has seen neither the person nor the others of the fold. These others' recordings are those
with slips. The set has no hand-over, so only samples that are no slip say what not to call.
"""

from __future__ import annotations

import sys
from collections.abc import Sequence
from dataclasses import asdict, dataclass

import numpy as np

from holdfast.core.contract import SITUATIONS, Json
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.graph import Outputs
from holdfast.evaluation.alarms import Answers
from holdfast.export.heads import riskier_argmax
from holdfast.export.learner import Learner, reference_votes, votes_in_all
from holdfast.export.spec import StepSpec
from holdfast.sessions.adapt import Evidence
from holdfast.sessions.adapt_evidence import Stream, corrected, stream_of
from holdfast.training.crossval import fit_learner
from holdfast.training.datasets import find
from holdfast.training.datasets.human_slip_uskin import load
from holdfast.training.featurise import (
    FloatRows,
    features_everywhere,
    features_of,
    spec_for,
)
from holdfast.training.metrics import situation_scores
from holdfast.training.plan import HIGH_CONFIDENCE, TrainingPlan
from holdfast.training.recording import DataSet, Recording, assign_groups, folds_of
from studies.adapt.figures import BEFORE, THRESHOLD, WHOLE, Way, way_figures

RULES = HIGH_CONFIDENCE["forest"]
ON = "familiarization"
FOLDS = 3
SEED = 0
EVERY = 4
"""Of the others' recordings, every fourth: the rule has few parameters, and fits sooner."""
TASK = "situations"


@dataclass(frozen=True)
class Person:
    """own: streams to adapt on. rest: to score on. others: of the fold's other people."""

    own: list[Stream]
    rest: list[Stream]
    others: list[Stream]


def study_people() -> Json:
    """Figures of every way over all people."""
    data = load(find("human_slip_uskin"))
    plan = TrainingPlan()
    spec = spec_for(data, plan.groups)
    features = features_of(data, spec)[TASK]
    folds = assign_groups(data.group_of(TASK), FOLDS, seed=SEED)
    ways: dict[str, list[Way]] = {}
    for number, (train, test) in enumerate(folds_of(data.group_of(TASK), folds)):
        sys.stderr.write(f"fold {number + 1} of {FOLDS}\n")
        learner = fit_learner(data, features, plan, TASK, train, SEED)
        people = data.of_groups(set(data.group_of(TASK)[test].tolist()))
        for person in _people(people, learner, spec):
            for name, way in _ways(person, votes_in_all(learner)).items():
                ways.setdefault(name, []).append(way)
    return {
        "kind": "public real data",
        "adapted_on": ON,
        "seed": SEED,
        "people": len(ways[BEFORE]),
        "ways": {
            name: {**asdict(way_figures(one)), "macro_f1": _macro_f1(data, one)}
            for name, one in ways.items()
        },
    }


def _people(data: DataSet, learner: Learner, spec: StepSpec) -> list[Person]:
    rows = features_everywhere(data, spec)
    streams = [
        _stream(one, of_one, learner, spec)
        for one, of_one in zip(data.recordings, rows, strict=True)
    ]
    return [_person(streams, name) for name in data.groups()]


def _stream(
    recording: Recording, rows: FloatRows, learner: Learner, spec: StepSpec
) -> Stream:
    votes = reference_votes(learner, rows, len(SITUATIONS))
    unknown = np.arange(len(rows)) < spec.settle_samples - 1
    found: Outputs = {
        "votes": votes,
        "features": rows,
        "unknown": unknown,
        "situation": riskier_argmax(votes),
    }
    return stream_of(recording, found)


def _person(streams: Sequence[Stream], name: str) -> Person:
    here = [one for one in streams if one.recording.group == name]
    return Person(
        own=[one for one in here if _is_first(one)],
        rest=[one for one in here if not _is_first(one)],
        others=[one for one in streams if one.recording.group != name][::EVERY],
    )


def _is_first(stream: Stream) -> bool:
    return (stream.recording.action or "").endswith(ON)


def _ways(person: Person, in_all: int) -> dict[str, Way]:
    ways: dict[str, Way] = {BEFORE: ([one.answers for one in person.rest], RULES)}
    if not person.own:
        return ways
    evidence = Evidence(person.own, person.others, RULES, None, in_all)
    for name in (THRESHOLD, WHOLE):
        point = evidence.choose(threshold_only=name == THRESHOLD)
        correction = evidence.correction(point)
        ways[name] = (
            [corrected(one, correction, None) for one in person.rest],
            point.rules,
        )
    return ways


def _macro_f1(data: DataSet, ways: Sequence[Way]) -> Json:
    """Macro F1 over four situations at the labelled windows, people held out."""
    answers = {one.recording.trial_id: one for way, _ in ways for one in way}
    task = data.tasks[TASK]
    label = []
    found = []
    groups = []
    for trial, row, true in zip(task.trial, task.row, task.label, strict=True):
        one: Answers | None = answers.get(data.recordings[trial].trial_id)
        if one is not None and one.situation[row] != UNKNOWN:
            label.append(true)
            found.append(one.situation[row])
            groups.append(one.recording.group)
    scores = situation_scores(
        np.array(label), np.array(found), np.array(groups), seed=SEED
    )
    return {"value": scores.macro_f1, "ci": scores.macro_f1_ci, "windows": len(label)}
