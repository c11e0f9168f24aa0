"""How many risky rotations of human_slip_uskin are found: by files with lifts, and by scenes alone.

A second test of deafness, on real recordings: 18 people pinch one object, which turns in the grip.
Both at the same false alarms a minute, so that neither is quiet by being deaf. No file learned from
any of these people. Each is answered by one of the files with lifts, dealt in turn, and by the file
of scenes alone.

The pad's 16 taxels are summed to one sensor, x, y and z as they were recorded. The finger opposite
had none: a second sensor feels the same normal force and the opposite shear. Samples at 58.9 Hz are
put on a straight line between each other at the rate of the files.

What this cannot say: nothing above 29 Hz is in the samples, and a line between two of them is
smoother than any touch, so features of vibration and of sudden change see too little. The label is
15 degrees of rotation of the object, about half of it the wrist's; its load onset is not known. An
alarm counts from 5 degrees on until the object has turned back below them or the contact is lost;
one that begins before 5 degrees is false, also where it sees the rotation come.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from holdfast.core.contract import GRASP, FloatArray, Json
from holdfast.core.hand_card import read_hand_card
from holdfast.data.datasets import load
from holdfast.data.metrics import draw_groups
from holdfast.data.recording import DataSet, Recording, finite_sensors, runs_of
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.evaluation.alarms import (
    DRAWS,
    EventMatch,
    choose_confidence,
    event_scores,
    ratio_interval,
)
from holdfast.evaluation.model_outputs import ModelOutputs, run_model
from studies.people.folds import few_recordings, for_hand
from studies.people.slips_found import matched

NAME = "human_slip_uskin"
CHANNELS = 48
"""All 16 taxels."""
CARD = "two-pad-gripper"
"""Two sensors that measure every axis, one a side."""
OPPOSITE = (-1.0, -1.0, 1.0)
"""What the second pad feels of the first one's x, y and z."""
MOST_FALSE_PER_MIN = (1.0, 5.0, 20.0)
"""Both are compared at these, and at what the files with lifts do at their own threshold."""


def read_rotations(rate_hz: float, *, quick: bool = False) -> DataSet:
    """The set as two pads would feel it, at a rate. quick: the few of `few_recordings`."""
    data = load(NAME, channels=CHANNELS)
    if quick:
        data = few_recordings(data, 2)
    recordings = [on_two_pads(one, rate_hz) for one in data.recordings]
    hand = read_hand_card(CARD)
    return replace(data, recordings=recordings, tasks={}, rate_hz=rate_hz, hand=hand)


def on_two_pads(recording: Recording, rate_hz: float) -> Recording:
    """A recording of one pad of many taxels as two sensors, up to the end of its labels.

    Rows count in which the object is held and has turned less than 5 degrees. A row with a lost
    value is invalid.
    """
    last = recording.phases[-1].stop - 1 if recording.phases else 0
    ends_s = last / recording.rate_hz
    t_s = np.arange(last + 1) / recording.rate_hz
    at_s = np.arange(int(ends_s * rate_hz + 1e-9) + 1) / rate_hz
    pad = recording.samples[: last + 1].reshape(last + 1, -1, 3).sum(axis=1)
    both = np.hstack([pad, pad * OPPOSITE])
    samples: FloatArray = np.stack(
        [np.interp(at_s, t_s, channel) for channel in both.T], axis=1
    )

    phases = []
    held = np.zeros(len(at_s), dtype=np.bool_)
    for phase in recording.phases:
        times = np.array([phase.first, phase.stop]) / recording.rate_hz
        first, stop = np.searchsorted(at_s, times).tolist()
        phases.append(replace(phase, first=first, stop=stop))
        held[first:stop] = phase.situation == GRASP
    firsts, stops = runs_of(~held)
    return replace(
        recording,
        samples=samples,
        valid=finite_sensors(samples),
        rate_hz=rate_hz,
        phases=tuple(phases),
        left_out=tuple(zip(firsts.tolist(), stops.tolist(), strict=True)),
    )


def rotations_found(
    with_lifts: Sequence[Path], scenes: Path, data: DataSet, seed: int
) -> Json:
    """Both at each number of false alarms a minute, with intervals over people, and by person.

    with_lifts, scenes: files for two pads that have the rules of one plan.
    """
    people = data.people()
    lifts: list[ModelOutputs] = []
    for number, path in enumerate(with_lifts):
        dealt = people[number :: len(with_lifts)]
        if dealt:
            lifts += run_model(_for_two_pads(path), data.of_groups(dealt))
    model = _for_two_pads(scenes)
    alone = run_model(model, data)
    rules = model.card.decision
    own = matched(lifts, rules, rules.min_risky_permille)
    at_own = event_scores(own).false_per_min or 0.0

    rows = []
    for most_false_per_min in (at_own, *MOST_FALSE_PER_MIN):
        row: Json = {"most_false_per_min": most_false_per_min}
        matches: list[list[EventMatch]] = []
        for name, outputs in (("with_lifts", lifts), ("scenes_alone", alone)):
            permille = choose_confidence(outputs, rules, most_false_per_min)
            matches.append(matched(outputs, rules, permille))
            scores = event_scores(matches[-1], seed=seed)
            row[name] = asdict(scores) | {"permille": permille}
        rows.append(row | compared(matches[0], matches[1], seed))
    return {"people": len(people), "trials": len(data.recordings), "rows": rows}


def compared(
    with_lifts: Sequence[EventMatch], scenes_alone: Sequence[EventMatch], seed: int
) -> Json:
    """The recall with lifts less that of scenes alone, its interval over people; by person."""
    names = ("with_lifts", "scenes_alone")
    counts: dict[str, FloatArray] = {}
    for column, matches in enumerate((with_lifts, scenes_alone)):
        for match in matches:
            of = counts.setdefault(match.recording.group, np.zeros(3))
            of[column] += sum(one.alarm_s is not None for one in match.outcomes)
            # both have the same rotations
            of[2] += len(match.outcomes) if column == 0 else 0

    # A draw takes a person's two counts together, so what makes a person hard cancels.
    sums = np.array([[one[0] - one[1], one[2]] for one in counts.values()])
    drawn = None
    if len(sums) > 1:
        drawn = draw_groups(len(sums), DRAWS, seed) @ sums
    change, rotations = sums.sum(axis=0).tolist()
    by_person = {}
    for person, (*found, of_all) in sorted(counts.items()):
        shares = [float(one / of_all) if of_all else None for one in found]
        by_person[person] = dict(zip(names, shares, strict=True))
    return {
        "change": change / rotations if rotations else None,
        "change_ci": ratio_interval(drawn, 0, 1),
        "recall_by_person": by_person,
    }


def _for_two_pads(path: Path) -> OpenedModel:
    """The same learner for the hand of the set; the file stands beside the one that is read."""
    return ModelChoice(str(for_hand(path, CARD, path.parent))).open()
