"""`python -m studies people`: how often a model alarms in plain lifts by people who are left out.

Five folds of two people. The model of a fold learns from scenes, two-pad scenes and the lifts of
the eight others, with the plan of the shipped file, and answers the whole recordings of the two.
Nothing is chosen on people: threshold and debounce are those of the plan, which were chosen on
development seeds of scenes.
"""

from __future__ import annotations

import argparse
import json
import resource
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from holdfast.cli.command import path_argument, positive
from holdfast.core.contract import Json
from holdfast.core.progress import Stages
from holdfast.data.datasets.grip_lift_ati import CARD
from holdfast.data.recording import DataSet
from holdfast.edge_runtime.engine import ModelChoice
from holdfast.evaluation.formats import interval, number
from holdfast.evaluation.model_outputs import run_model
from holdfast.training.plan import PLANS, at_rate
from studies.model_sets import QUICK_TRIALS, training_sets
from studies.people.figures import Lifts, lifts_of, parts_of, summary
from studies.people.folds import (
    FoldFile,
    Study,
    fold_files,
    for_hand,
    read_study,
    scenes_file,
)
from studies.people.lifts_and_scenes import force_rows, told_apart
from studies.people.rotations import read_rotations, rotations_found
from studies.people.slips_found import (
    SLIP_TRIALS,
    slips_for_lifts,
    slips_found,
    two_pads_found,
)
from tools.harness import measured_now, write_figures

COLUMNS = {
    "alarms_a_minute_of_recording": "alarms a minute",
    "alarms_a_minute_of_contact": "alarms a minute of contact",
    "lifts_with_an_alarm": "share of lifts with an alarm",
    "alarms_a_minute_in_the_first_0_2_s": "alarms a minute, first 0.2 s of contact",
    "alarms_a_minute_in_the_hold": "alarms a minute, hold",
    "alarms_a_minute_in_the_last_0_15_s": "alarms a minute, last 0.15 s of contact",
    "lifts_squeezed": "share of lifts squeezed",
    "lifts_squeezed_without_model": "share of lifts squeezed, all probabilities 0",
}
"""Figure -> its line."""
BOTH = ("with_lifts", "scenes_alone")
"""Files that learned from lifts too, and the one that did not."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument("--rate", type=positive, default=150.0, metavar="HZ")
    parser.add_argument(
        "--sets",
        type=path_argument,
        metavar="DIR",
        help="folder of the simulated sets, which are made where they are missing "
        "(default: that of the results)",
    )
    parser.add_argument(
        "--older",
        type=path_argument,
        metavar="FILE",
        help="an older file that learned from no person, as a row beside",
    )
    parser.add_argument(
        "--kept",
        type=path_argument,
        metavar="FILE",
        help="print the table of an earlier run, and compute nothing",
    )
    parser.add_argument(
        "--quick",
        action="store_true",
        help="two people, few trials, the tiny size: whether it runs, no figure",
    )


def run(args: argparse.Namespace) -> int:
    """Train the folds, answer the people who are left out; people.json and a table."""
    if args.kept:
        kept: Json = json.loads(args.kept.read_text("utf-8"))
        print("\n".join([f"{kept['command']}, {kept['measured_on']}", *_lines(kept)]))
        return 0
    say = Stages()
    sets = training_sets(args.sets or args.out, args.rate, quick=args.quick)
    size = "tiny" if args.quick else "default"
    plan = at_rate(PLANS["pooled"](size, "committee"), args.rate)
    study = read_study(sets, plan, args.rate, args.seed, say, quick=args.quick)

    rows: dict[str, Lifts] = {}
    if args.older:
        say(f"answers of {args.older}")
        rows["older file"] = _answered(
            for_hand(args.older, CARD, args.out), study.streams
        )
    files = fold_files(study, args.out, say)
    left_out = Lifts((), ())
    for file in files:
        say(f"answers for {' and '.join(file.people)}")
        left_out += _answered(file.path, study.streams.of_groups(file.people))
    rows["people left out"] = left_out

    found = _found(study, files, args, say)
    say("lifts beside scenes")
    pads = [data for data in study.sets if data.hand and data.hand.name == CARD]
    lacking = force_rows(study.streams, pads[:-1])

    figures: Json = {
        **measured_now(),
        "kind": study.streams.kind,
        "caveat": study.streams.caveat,
        "plan": study.plan.to_json(),
        "sets": [asdict(origin) for origin in study.data.origins],
        "quick": args.quick,
        "cpu_minutes": _cpu_minutes(),
        "rows": {name: summary(lifts, args.seed) for name, lifts in rows.items()},
        **found,
        "forces": [asdict(row) for row in lacking],
        "told_apart": asdict(told_apart(study.streams, pads[:-1], args.seed)),
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


def _found(
    study: Study, files: Sequence[FoldFile], args: argparse.Namespace, say: Stages
) -> Json:
    """What files that learned from lifts find beside one that learned from scenes alone."""
    folder, rate_hz = args.sets or args.out, args.rate
    say("slips put into real holds")
    trials = QUICK_TRIALS if args.quick else SLIP_TRIALS
    slips = slips_for_lifts(folder, rate_hz, trials)
    scenes = scenes_file(study, args.out, say)
    in_lifts = slips_found(files, scenes, study.streams, slips, args.seed)
    say("slips in two-pad scenes")
    in_scenes = two_pads_found(files[0].path, scenes, folder, rate_hz, trials)
    say("rotations of an object that people pinch")
    pinched = read_rotations(rate_hz, quick=args.quick)
    paths = [file.path for file in files]
    return {
        "slips_in_lifts": in_lifts,
        "slips_in_two_pad_scenes": in_scenes,
        "rotations_in_pinches": rotations_found(paths, scenes, pinched, args.seed),
    }


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
        lines.append(
            f"{name}: {row['people']} people, {row['lifts']} lifts, "
            f"{row['minutes']:.1f} minutes"
        )
        for key, words in COLUMNS.items():
            value, ends = row[key]["value"], row[key]["ci"]
            lines.append(f"  {words}: {number(value)} ({interval(ends)})")
    return [*lines, *_found_lines(figures), *_force_lines(figures)]


def _found_lines(figures: Json) -> list[str]:
    """Of slips in real lifts and in two-pad scenes: found with lifts, and by scenes alone."""
    lifts = figures["slips_in_lifts"]
    rows = {"slips put into lifts": {name: lifts[name]["recall"] for name in BOTH}}
    rows |= lifts["recall_by_person"]
    for scene, found in figures["slips_in_two_pad_scenes"].items():
        rows[f"two-pad {scene}"] = {name: found[name]["recall"] for name in BOTH}
    lines = ["found: with lifts, scenes alone"]
    for name, found in rows.items():
        shares = ", ".join(number(found[which]) for which in BOTH)
        lines.append(f"  {name}: {shares}")
    return lines


def _force_lines(figures: Json) -> list[str]:
    """The median forces of each person and scene, and what tells their quiet holds apart."""
    # actions of a scene are in the JSON alone
    rows = [row for row in figures["forces"] if row["kind"] != "action"]
    lines = [f"median of: {', '.join(rows[0]['measures'])}"]
    for row in rows:
        medians = [number(one["median"]) for one in row["measures"].values()]
        lines.append(
            f"  {row['name']}, {row['contacts']} contacts: {', '.join(medians)}"
        )
    apart = figures["told_apart"]
    features = ", ".join(name for name, _ in apart["strongest"])
    auc = number(apart["auc"])
    lines.append(
        f"a learner distinguishes quiet holds of lifts and scenes (AUC {auc}) by {features}"
    )
    return lines
