"""`python -m studies people`: how often a model alarms in plain lifts by people who are left out.

Five folds of two people. A model of each learns from the scenes, the two-pad scenes and the lifts
of the eight others, with the plan of the shipped file, and answers the whole recordings of the two.
Nothing is chosen on people: threshold and debounce are those of the plan, which were chosen on
development seeds of scenes.
"""

from __future__ import annotations

import argparse
import resource
import tempfile
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.cli.command import path_argument, positive
from holdfast.core.contract import Json
from holdfast.core.hand_card import read_hand_card
from holdfast.core.locked import require_open_people
from holdfast.core.writing import write_whole
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.evaluation.formats import interval, number
from holdfast.evaluation.model_outputs import ModelOutputs, run_model
from holdfast.export.artifact import write_artifact
from holdfast.export.changed import changed
from holdfast.export.exporting import export_artifact
from holdfast.training.crossval import FloatRows
from holdfast.training.datasets import load
from holdfast.training.datasets.grip_lift_ati import CARD
from holdfast.training.datasets.grip_lift_ati import NAME as LIFTS
from holdfast.training.datasets.joining import join
from holdfast.training.fitting import fitted, with_features
from holdfast.training.plan import PLANS, TrainingPlan, at_rate
from holdfast.training.progress import Stages
from holdfast.training.recording import DataSet, assign_groups, learnable
from studies.model_sets import training_sets
from studies.people.figures import Lifts, lifts_of, parts_of, summary
from tools.harness import measured_now, write_figures

FOLDS = 5
QUICK_PEOPLE = 2
COLUMNS = {
    "alarms_a_minute_of_recording": "alarms a minute",
    "alarms_a_minute_of_contact": "a minute of contact",
    "lifts_with_an_alarm": "lifts with one",
    "alarms_a_minute_in_the_first_0_2_s": "first 0.2 s",
    "alarms_a_minute_in_the_hold": "hold",
    "alarms_a_minute_in_the_last_0_15_s": "last 0.15 s",
    "lifts_squeezed": "lifts squeezed",
    "lifts_squeezed_without_model": "squeezed without model",
}
"""Figure -> its head in the table that is printed."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument("--rate", type=positive, default=150.0, metavar="HZ")
    parser.add_argument(
        "--sets",
        type=path_argument,
        metavar="DIR",
        help="folder of the simulated sets, which are made where they are missing (default in DIR)",
    )
    parser.add_argument(
        "--older",
        type=path_argument,
        metavar="FILE",
        help="an older file that learned from no person, as a row beside",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="two people, few trials, the tiny size: whether it runs, no figure",
    )


def run(args: argparse.Namespace) -> int:
    """Train the folds, answer the people who are left out; figures.json and a table."""
    say = Stages()
    sets = training_sets(args.sets or args.out, args.rate, quick=args.quick)
    size = "tiny" if args.quick else "default"
    plan = at_rate(PLANS["pooled"](size, "committee"), args.rate)
    study = _read(sets, plan, args.rate, args.quick, args.seed, say)

    rows: dict[str, Lifts] = {}
    if args.older:
        say(f"answers of {args.older}")
        rows["older file"] = _answered(_for_pads(args.older, args.out), study.streams)
    rows["people left out"] = _left_out(study, args.seed, say)

    figures: Json = {
        **measured_now(),
        "kind": study.streams.kind,
        "caveat": study.streams.caveat,
        "plan": plan.to_json(),
        "quick": args.quick,
        "cpu_minutes": _cpu_minutes(),
        "rows": {name: summary(lifts, args.seed) for name, lifts in rows.items()},
        "by_person": {
            name: parts_of(lifts, lambda lift: lift.person)
            for name, lifts in rows.items()
        },
        "by_object": {
            name: parts_of(lifts, lambda lift: lift.object_name)
            for name, lifts in rows.items()
        },
    }
    path = write_figures(args.out / "people.json", figures)
    print("\n".join([*_lines(figures), str(path)]))
    return 0


@dataclass(frozen=True)
class Study:
    """What the folds share. data, features: of all windows; streams: the lifts, whole."""

    data: DataSet
    features: dict[str, FloatRows]
    streams: DataSet
    plan: TrainingPlan


def _read(
    sets: list[str],
    plan: TrainingPlan,
    rate_hz: float,
    quick: bool,
    seed: int,
    say: Stages,
) -> Study:
    """Read all sets and compute the features of every window once."""
    loaded = []
    for name in sets:
        say(f"reading {name}")
        data = load(name, rate_hz=rate_hz, windows="dense", seed=seed)
        people = data.people()
        require_open_people(data.name, people, "a model")
        if data.name == LIFTS and quick:
            data = data.of_groups(people[:QUICK_PEOPLE])
        loaded.append(data)
    streams = loaded[-1]
    data = learnable(join(loaded, several_hands=True))
    data, features = with_features(data, plan, seed, say, say.part)
    return Study(data, features, streams, plan)


def _left_out(study: Study, seed: int, say: Stages) -> Lifts:
    """The lifts of all people, each answered by a model that has not learned from them."""
    people = study.streams.people()
    folds = assign_groups(people, min(FOLDS, len(people)), seed=seed)
    found = Lifts((), ())
    for fold in sorted(set(folds.values())):
        out = {person for person, of in folds.items() if of == fold}
        say(f"fold {fold + 1}: without {', '.join(sorted(out))}")
        with tempfile.TemporaryDirectory() as folder:
            model = model_of(study, out, Path(folder), seed)
            found += _answered(model, study.streams.of_groups(out))
    return found


def model_of(study: Study, without: Collection[str], folder: Path, seed: int) -> Path:
    """A file for two pads that has learned from no lift of these people."""
    names = {f"{LIFTS}/{person}" for person in without}
    groups = [name for name in study.data.groups() if name not in names]
    data = study.data.of_groups(groups)
    features = {}
    for task, rows in study.features.items():
        kept = np.isin(study.data.group_of(task), groups)
        features[task] = rows[kept]
    _, _, artifact = fitted(data, features, study.plan, seed)
    write_artifact(folder, artifact)
    path, _ = export_artifact(folder, hand=read_hand_card(CARD))
    return path


def _for_pads(model: Path, out: Path) -> Path:
    """The same learner for two pads."""
    hand = read_hand_card(CARD)
    path = out / "older-two-pads.onnx"
    write_whole(path, changed(read_sealed(model), hand, {}, model))
    return path


def answers_of(model: Path, streams: DataSet) -> list[ModelOutputs]:
    """What a file answers on recordings, each from a fresh state."""
    return run_model(ModelChoice(str(model)).open(), streams)


def _answered(model: Path, streams: DataSet) -> Lifts:
    """What a file does in recordings, by the rules of its own card."""
    opened = ModelChoice(str(model)).open()
    rules = opened.card.decision
    outputs = run_model(opened, streams)
    return lifts_of(outputs, rules, rules.min_risky_permille)


def _cpu_minutes() -> float:
    """Of this process and of those that it started."""
    seconds = 0.0
    for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN):
        used = resource.getrusage(who)
        seconds += used.ru_utime + used.ru_stime
    return seconds / 60.0


def _lines(figures: Json) -> list[str]:
    """The rows as lines, with intervals over people."""
    lines = []
    for name, row in figures["rows"].items():
        lines.append(f"{name}: {row['people']} people, {row['lifts']} lifts")
        for key, head in COLUMNS.items():
            value = row[key]
            lines.append(f"  {head}: {number(value['value'])} {interval(value['ci'])}")
    return lines
