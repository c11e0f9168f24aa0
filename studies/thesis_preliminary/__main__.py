"""`python -m studies.thesis_preliminary --out DIR`: preliminary.json and report.html.

DIR/scene (or --scene) is what `holdfast simulate twenty-sensors --out DIR/scene` wrote; the
recordings of people are the public set human_slip_uskin, all 48 channels.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from holdfast.cli.command import Parser, finish, path_argument, seed
from holdfast.core.errors import DataNotFound
from holdfast.core.writing import require_writable, write_whole
from holdfast.evaluation.provenance import host
from holdfast.training.datasets import load
from holdfast.training.fitting import versions
from holdfast.training.progress import Say, stages
from holdfast.training.recording import DataSet
from studies.real.methods import HUMAN
from studies.thesis_preliminary.cases import CASES
from studies.thesis_preliminary.figures import PreliminaryStudy
from studies.thesis_preliminary.report import summary, write_preliminary_report
from studies.thesis_preliminary.study import REPETITIONS, study

STAGES = 1 + 2 * (3 + len(CASES))
CARD = "twenty-sensors"


def run(scene: Path, seed: int, say: Say) -> PreliminaryStudy:
    """Study both sets. Raises DataNotFound and what `study` raises."""
    started = time.perf_counter()
    sets = []
    for what, read in (
        (str(scene), lambda: read_scene(scene)),
        (HUMAN, lambda: load(HUMAN, channels=48)),
    ):
        say(f"reading {what}")
        sets.append(study(read(), seed=seed, say=say))
    seconds = round(time.perf_counter() - started, 1)
    return PreliminaryStudy(sets, REPETITIONS, seed, host(), versions(), seconds)


def read_scene(folder: Path) -> DataSet:
    """The simulated set. Raises DataNotFound with the command that makes it."""
    if not folder.is_dir():
        raise DataNotFound(
            "no scene to study",
            where=folder,
            next_step=f"holdfast simulate {CARD} --out {folder}",
        )
    return load(folder, windows="natural")


def main(argv: Sequence[str]) -> int:
    """Parse, run, write preliminary.json and the report, print the table's main lines."""
    parser = Parser(
        prog="preliminary.py",
        description="the thesis' preliminary study, on a scene and on recordings",
    )
    parser.add_argument(
        "--out", type=path_argument, default=Path("build/preliminary"), metavar="DIR"
    )
    parser.add_argument(
        "--scene",
        type=path_argument,
        metavar="DIR",
        help="a simulated set (default: scene in --out)",
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="S")
    args: argparse.Namespace = parser.parse_args(argv)
    require_writable(args.out)
    with stages(STAGES) as say:
        figures = run(args.scene or args.out / "scene", args.seed, say)
        say("report")
    text = json.dumps(figures.to_json(), indent=1, allow_nan=False)
    write_whole(args.out / "preliminary.json", text + "\n")
    page = write_preliminary_report(args.out / "report.html", figures)
    where = f"{args.out / 'preliminary.json'}, {page} ({figures.seconds} s)"
    sys.stdout.write("\n".join([*summary(figures), where]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
