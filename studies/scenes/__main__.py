"""`python -m studies.scenes FOLDER --out DIR`: writes scenes.json and report.html.

FOLDER/<rate>hz/<card> are sets that `holdfast simulate <card> --rate <rate>` wrote: thesis, and,
where they are there, apple, p1 and p2. Everything here is simulated, and says so.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import time
from collections.abc import Sequence
from dataclasses import asdict
from pathlib import Path

from holdfast.cli.command import Parser, finish, path_argument, seed
from holdfast.core.errors import DataNotFound
from holdfast.core.writing import require_writable, write_whole
from holdfast.evaluation.provenance import host
from holdfast.evaluation.scores import LeakCheck
from holdfast.training.fitting import versions
from holdfast.training.progress import Say, stages
from studies.row_names import OURS
from studies.scenes.evidence import SceneEvidence, between, number
from studies.scenes.figures import MadeBy, ScenesFigures
from studies.scenes.report import write_scene_report
from studies.scenes.study import CAVEAT, STAGES, RateStudy, study_rate, ways

RATE_FOLDER = re.compile(r"(\d+(?:\.\d+)?)hz")


def run(folder: Path, out: Path, seed: int, say: Say) -> tuple[ScenesFigures, MadeBy]:
    """Study every rate of a folder and write the report."""
    started = time.perf_counter()
    studies = [study_rate(rate, ways(), seed, say) for rate in rate_folders(folder)]
    figures, last = gathered(studies), studies[-1]
    made = MadeBy(seed, versions(), seconds=round(time.perf_counter() - started, 1))
    say("report")
    evidence = SceneEvidence(figures, made, last.data, last.held_out, last.streams)
    write_scene_report(out / "report.html", evidence)
    return figures, made


def rate_folders(folder: Path) -> list[Path]:
    """The folders <rate>hz of a folder, slowest first. Raises DataNotFound."""
    places = list(folder.iterdir()) if folder.is_dir() else []
    found = [
        (float(match[1]), path)
        for path in places
        if (match := RATE_FOLDER.fullmatch(path.name))
    ]
    if not found:
        raise DataNotFound(
            "no folder <rate>hz in it",
            where=folder,
            next_step=f"holdfast simulate thesis --rate 150 --out {folder / '150hz' / 'thesis'}",
        )
    return [path for _, path in sorted(found)]


def gathered(studies: Sequence[RateStudy]) -> ScenesFigures:
    """The figures of all rates; the fastest rate is the headline."""
    rates = {f"{study.figures.rate_hz:g}": study.figures for study in studies}
    kinds = {study.data.kind for study in studies}
    return ScenesFigures(kinds.pop() if len(kinds) == 1 else "mixed", CAVEAT, rates)


def leak_lines(figures: ScenesFigures) -> list[str]:
    """One line for each rate at which the weight leaks."""
    checks = {rate: one.leak for rate, one in figures.rates.items()}
    return [
        _leak_line(rate, one)
        for rate, one in checks.items()
        if one is not None and one.leak
    ]


def _leak_line(rate: str, one: LeakCheck) -> str:
    return (
        f"LEAK at {rate} Hz: the weight is known where no signal carries it: eight classes "
        f"{number(one.eight_class_accuracy)} (99 %: {between(one.eight_class_accuracy_ci99)}, "
        f"ceiling {one.ceiling}), weight within nothing {number(one.weight_within_nothing)} "
        f"(99 %: {between(one.weight_within_nothing_ci99)}, chance 0.5)"
    )


def main(argv: Sequence[str]) -> int:
    """Parse, run, write scenes.json, print the headline."""
    parser = Parser(prog="scenes.py", description="the whole study of simulated scenes")
    parser.add_argument(
        "folder",
        type=path_argument,
        metavar="FOLDER",
        help="holds <rate>hz/thesis and other sets that simulate wrote",
    )
    parser.add_argument(
        "--out", type=path_argument, default=Path("build/scenes"), metavar="DIR"
    )
    parser.add_argument("--seed", type=seed, default=0, metavar="S")
    args: argparse.Namespace = parser.parse_args(argv)
    require_writable(args.out)
    with stages(1 + STAGES * len(rate_folders(args.folder))) as say:
        figures, made = run(args.folder, args.out, args.seed, say)
    written = figures.to_json() | {
        "seed": made.seed,
        "host": asdict(host()),
        "versions": made.versions,
        "seconds": made.seconds,
    }
    write_whole(
        args.out / "scenes.json", json.dumps(written, indent=1, allow_nan=False) + "\n"
    )
    best = figures.rates[figures.headline_hz].scores(OURS).four
    lines = [
        f"{figures.kind}, {figures.headline_hz} Hz, trials held out: macro F1 over four "
        f"situations {number(best.macro_f1)} ({between(best.macro_f1_ci)})",
        *leak_lines(figures),
        f"{args.out / 'scenes.json'}, {args.out / 'report.html'} ({made.seconds} s)",
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
