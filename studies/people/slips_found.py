"""How many slips are found by files that learned from lifts too, and by one of scenes alone.

In real holds both at the same alarms a minute on the untouched lifts, so that neither is quiet by
being deaf; in two-pad scenes both at the same confidence.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, replace
from pathlib import Path

import numpy as np

from holdfast.core.contract import Json
from holdfast.data.datasets import load
from holdfast.data.recording import DataSet
from holdfast.edge_runtime.decision import DecisionRules
from holdfast.edge_runtime.engine import ModelChoice, OpenedModel
from holdfast.evaluation.alarms import (
    EventMatch,
    choose_confidence,
    event_scores,
    match_alarms,
    requests_at,
)
from holdfast.evaluation.model_outputs import ModelOutputs, run_model
from studies.people.deafness import SimulatedSlip, by_speed, simulated_slips, with_slips
from studies.people.folds import FoldFile
from studies.people.two_pads import two_pad_name, write_two_pad_scene
from tools.harness import SimulatedSet, simulate_sets

SLIP_SCENES = ("thesis", "wide")
SLIP_SEED, PAD_SEED = 110, 111
SLIP_TRIALS = 120
"""Of each scene; no set that a file learns from has these seeds."""


def slips_for_lifts(
    folder: Path, rate_hz: float, trials: int = SLIP_TRIALS
) -> list[SimulatedSlip]:
    """Slips of two-pad scenes at a rate, whose cards are written into a folder.

    trials: of each scene.
    """
    slips: list[SimulatedSlip] = []
    for scene in SLIP_SCENES:
        card = write_two_pad_scene(scene, rate_hz, folder)
        slips += simulated_slips(card, SLIP_SEED, trials)
    return by_speed(slips)


def slips_found(
    files: Sequence[FoldFile],
    scenes: Path,
    lifts: DataSet,
    slips: Sequence[SimulatedSlip],
    seed: int,
) -> Json:
    """Recall and delay of both, by person too, and the confidences at which they were compared."""
    rng = np.random.default_rng(seed)
    slipping = replace(
        lifts, recordings=[with_slips(one, slips, rng) for one in lifts.recordings]
    )
    with_lifts: list[EventMatch] = []
    false, minutes, permille = 0, 0.0, 0
    for file in files:
        model = _opened(file.path)
        permille = model.card.decision.min_risky_permille
        for match in _matched(model, lifts.of_groups(file.people), permille):
            false += len(match.false_s)
            minutes += match.minutes
        with_lifts += _matched(model, slipping.of_groups(file.people), permille)

    model = _opened(scenes)
    quiet = run_model(model, lifts)
    rules = model.card.decision
    alone = choose_confidence(quiet, rules, false / minutes)
    scenes_alone = _matched(model, slipping, alone)
    alarms = sum(len(match.false_s) for match in matched(quiet, rules, alone))
    return {
        "slips": len(slips),
        "with_lifts_false_a_minute": false / minutes,
        "scenes_alone_false_a_minute": alarms / minutes,
        "permille_with_lifts": permille,
        "permille_scenes_alone": alone,
        "with_lifts": asdict(event_scores(with_lifts, seed=seed)),
        "scenes_alone": asdict(event_scores(scenes_alone, seed=seed)),
        "recall_by_person": {
            person: {
                "with_lifts": _recall(with_lifts, person),
                "scenes_alone": _recall(scenes_alone, person),
            }
            for person in lifts.people()
        },
    }


def two_pads_found(
    file: Path, scenes: Path, folder: Path, rate_hz: float, trials: int = SLIP_TRIALS
) -> Json:
    """By scene: recall in its two-pad form by both, at the confidence of the file with lifts.

    The sets are made in a folder where they are missing. trials: of each scene.
    """
    with_lifts, alone = _opened(file), _opened(scenes)
    permille = with_lifts.card.decision.min_risky_permille
    found: Json = {}
    for scene in SLIP_SCENES:
        card = write_two_pad_scene(scene, rate_hz, folder)
        one = SimulatedSet(
            f"{two_pad_name(scene)}-{PAD_SEED}", str(card), trials, PAD_SEED, rate_hz
        )
        if not (folder / one.folder).is_dir():
            simulate_sets([one], folder)
        data = load(str(folder / one.folder), rate_hz=rate_hz, seed=0)
        found[scene] = {
            name: asdict(event_scores(_matched(model, data, permille)))
            for name, model in (("with_lifts", with_lifts), ("scenes_alone", alone))
        }
    return found


def _opened(path: Path) -> OpenedModel:
    return ModelChoice(str(path)).open()


def _matched(model: OpenedModel, data: DataSet, permille: int) -> list[EventMatch]:
    """The alarms of a file from a confidence on, matched with the events."""
    return matched(run_model(model, data), model.card.decision, permille)


def matched(
    outputs: Sequence[ModelOutputs], rules: DecisionRules, permille: int
) -> list[EventMatch]:
    """The alarms of recordings as they were answered, matched with their events."""
    requests = requests_at(outputs, rules, permille)
    return [
        match_alarms(one.recording, on)
        for one, on in zip(outputs, requests, strict=True)
    ]


def _recall(matches: Sequence[EventMatch], person: str) -> float | None:
    """Share of a person's slips that were found."""
    found = []
    for match in matches:
        if match.recording.person == person:
            found += [outcome.alarm_s is not None for outcome in match.outcomes]
    return float(np.mean(found)) if found else None
