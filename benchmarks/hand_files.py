"""`python -m benchmarks hand-files`: one file for each hand, or one padded file for all.

What a step of either costs, in one run, and what it answers on the same trials. The same learner
stands behind both, and an older file beside them (--older). A padded file has twelve slots, of
which this hand fills six; the others are never valid.
"""

from __future__ import annotations

import argparse
from collections.abc import Mapping
from pathlib import Path

import numpy as np

from benchmarks.timed_calls import step_call, times_beside
from holdfast.cli.command import path_argument
from holdfast.core.contract import BoolArray, FloatArray, IntArray
from holdfast.core.errors import UsageError
from holdfast.core.hand_card import HandCard, HandContact, hand_of_counts
from holdfast.core.reading import Json, model_path
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.edge_runtime.graph import open_session, run_recordings
from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.edge_runtime.preparation import Preparation
from holdfast.evaluation.latency.timing import CALLS_A_TURN, TURNS
from holdfast.export.again import for_hand
from holdfast.simulation.scene import Scene
from holdfast.simulation.scene_file import read_scene_file
from tools.harness import write_figures

SLOTS = 12
SENSORS = 6
TWELVE = "the same learner, twelve slots, six never valid"
SIX = "the same learner, exported for six fingertips"
GIVEN = "the file as it is"
OLDER = "the older file"
SAMPLES = 3000
SEED = 0
SCENE, TRIALS, SCENE_SEED = "thesis", 20, 100
"""Trials that every file answers; a development seed."""
SHOWN = ("situation", "unknown")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this program."""
    option = parser.add_argument
    out, model = Path("build/bench"), model_path("holdfast-150hz")
    option("--out", type=path_argument, default=out, metavar="DIR")
    option("--model", type=path_argument, default=model, metavar="FILE")
    older = "another file of six sensors, timed in the same run"
    option("--older", type=path_argument, metavar="FILE", help=older)


def run(args: argparse.Namespace) -> int:
    """Time the files, write hand-files.json, print a line for each."""
    figures = step_times(args.model, args.older)
    figures["model_id"] = Model(args.model).card.model_id
    if args.older is not None:
        figures["older_id"] = Model(args.older).card.model_id
    path = write_figures(args.out / "hand-files.json", figures)
    for row in figures["rows"]:
        line = f"{row['file']}: {row['step_us']:.1f} us, {row['over_first']:.2f} times"
        if row["answered"] is not None:
            line += f", {row['answered']:.3f} answered, {row['same']:.3f} the same"
        print(line)
    print(path)
    return 0


def padded(hand: HandCard) -> HandCard:
    """The card of a hand, filled with slots to SLOTS sensors on its opposing side."""
    slots = [
        HandContact(f"unused-{k}", "opposing", 0.0)
        for k in range(SLOTS - hand.n_sensors)
    ]
    return HandCard(f"{hand.name}, padded", (*hand.contacts, *slots))


def step_times(
    path: Path,
    older: Path | None = None,
    turns: int = TURNS,
    calls: int = CALLS_A_TURN,
) -> Json:
    """us of a step: median, 99 %, and over that of the file as it is; the reference's own spread.

    path: a file of six sensors whose features are pooled; of another file only it itself is timed.
    older: another file of six sensors. Both are read, not changed.
    """
    data = read_sealed(path)
    files = {GIVEN: data} | _for_hands(data)
    if older is not None:
        files[OLDER] = read_sealed(older)
    steps = {}
    for name, one in files.items():
        slots = SLOTS if name == TWELVE else SENSORS
        steps[name] = step_call(one, _grips(slots), np.arange(slots) < SENSORS)
    times = times_beside(steps, turns, calls)
    said = _answers(files, path)
    nothing = {"answered": None, "same": None}
    rows = [{"file": name} | of | said.get(name, nothing) for name, of in times.items()]
    return {"rows": rows, "turns": turns, "calls_a_turn": calls}


def _answers(files: Mapping[str, bytes], path: Path) -> dict[str, Json]:
    """By file: share of the samples with an answer, and with that of the file as it is."""
    preparation = Model(path).card.preparation
    values, valid = _trials(preparation)
    labels: dict[str, IntArray] = {}
    for name, data in files.items():
        more = (SLOTS if name == TWELVE else SENSORS) - SENSORS
        padded_values = [np.pad(one, ((0, 0), (0, 3 * more))) for one in values]
        padded_valid = [np.pad(one, ((0, 0), (0, more))) for one in valid]
        rows = [np.arange(len(one)) for one in values]
        session = open_session(data)
        found = run_recordings(session, padded_values, padded_valid, SHOWN, rows)
        shown = [
            np.where(one["unknown"].ravel(), UNKNOWN, one["situation"].ravel())
            for one in found
        ]
        labels[name] = np.concatenate(shown)
    first = labels[GIVEN]
    settled = first != UNKNOWN
    return {
        name: {
            "answered": float(np.mean(of[settled] != UNKNOWN)),
            "same": float(np.mean(of[settled] == first[settled])),
        }
        for name, of in labels.items()
    }


def _trials(preparation: Preparation) -> tuple[list[FloatArray], list[BoolArray]]:
    """(values [T, C] prepared, valid [T, S]) of some simulated trials."""
    scene = Scene(read_scene_file(SCENE), SCENE_SEED)
    values = []
    valid = []
    for one in scene.run(scene.trials(TRIALS)):
        raw = one.signal.values.reshape(len(one.signal.values), -1)
        values.append(preparation.apply(raw))
        valid.append(one.signal.valid)
    return values, valid


def _for_hands(data: bytes) -> dict[str, bytes]:
    """The learner of a file behind the steps of two hands; none for a file of fixed features."""
    hand = hand_of_counts()
    try:
        return {SIX: for_hand(data, hand)[1], TWELVE: for_hand(data, padded(hand))[1]}
    except UsageError:
        return {}


def _grips(slots: int) -> FloatArray:
    """[SAMPLES, 3 x slots] forces of a hand that holds something, none in slots beyond six.

    The time hardly depends on them.
    """
    rng = np.random.default_rng(SEED)
    forces_n = np.zeros((SAMPLES, slots, 3))
    forces_n[:, :SENSORS] = rng.normal(0.0, 0.02, (SAMPLES, SENSORS, 3))
    forces_n[:, :SENSORS] += np.array([0.3, 0.1, 2.0])
    return forces_n.reshape(SAMPLES, -1)
