"""`python -m studies preliminary`: preliminary.json, which docs/thesis.md shows.

The scene is simulated first, unless --scene names one that is there already; the
recordings of people are the public set human_slip_uskin, all 48 channels.
"""

from __future__ import annotations

import argparse
import sys
import time
from pathlib import Path

from holdfast.cli.command import path_argument
from holdfast.core.errors import DataNotFound
from holdfast.core.progress import Say, Stages
from holdfast.core.writing import require_writable
from holdfast.data.datasets import load
from holdfast.data.recording import DataSet
from holdfast.training.fitting import versions
from studies.real.methods import HUMAN
from studies.thesis_preliminary.cases import CASES
from studies.thesis_preliminary.figures import PreliminaryStudy
from studies.thesis_preliminary.published import ACCURACY_PERCENT, LEARNERS
from studies.thesis_preliminary.study import REPETITIONS, study
from tools.harness import SimulatedSet, simulate_sets, write_figures

CARD = "twenty-sensors"


def study_sets(scene: Path, seed: int, say: Say) -> PreliminaryStudy:
    """Study both sets. Raises DataNotFound and what `study` raises."""
    started = time.perf_counter()
    say(f"reading {scene}")
    sets = [study(read_scene(scene), seed=seed, say=say)]
    say(f"reading {HUMAN}")
    sets.append(study(load(HUMAN, channels=48), seed=seed, say=say))
    seconds = round(time.perf_counter() - started, 1)
    return PreliminaryStudy(sets, REPETITIONS, seed, versions(), seconds)


def read_scene(folder: Path) -> DataSet:
    """The simulated set. Raises DataNotFound with the command that makes it."""
    if not folder.is_dir():
        raise DataNotFound(
            "no scene to study",
            where=folder,
            next_step=f"holdfast simulate {CARD} --out {folder}",
        )
    return load(folder, windows="natural")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    parser.add_argument(
        "--scene",
        type=path_argument,
        metavar="DIR",
        help="a simulated set that is there already (default: simulated into --out)",
    )


def run(args: argparse.Namespace) -> int:
    """Study both sets; write preliminary.json; print the main lines."""
    require_writable(args.out)
    if args.scene is None:
        simulate_sets([SimulatedSet("scene", CARD)], args.out)
    say = Stages()
    figures = study_sets(args.scene or args.out / "scene", args.seed, say)
    path = write_figures(args.out / "preliminary.json", figures.to_json())
    where = f"{path} ({figures.seconds} s)"
    sys.stdout.write("\n".join([*summary(figures), where]) + "\n")
    return 0


def summary(figures: PreliminaryStudy) -> list[str]:
    """One line a case: accuracy in % of the random forest, published and ours."""
    lines = ["random forest, accuracy in %, published | ours"]
    for case in CASES:
        ours = []
        for one in figures.sets:
            score = one.cases[case.name].accuracy[LEARNERS[0]]
            ours.append(f"{one.data} {100 * score.mean:.1f} ± {100 * score.sd:.1f}")
        published = ACCURACY_PERCENT[case.name][0]
        lines.append(f"case {case.name}: {published:.2f} | {', '.join(ours)}")
    return lines
