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
from typing import Any

from edge_runtime.command import Parser, finish, path_argument, seed
from edge_runtime.errors import DataNotFound
from edge_runtime.writing import require_writable, write_whole
from evaluation.provenance import host
from studies.row_names import OURS
from studies.scenes.candidate import Candidate
from studies.scenes.evidence import SceneEvidence, between
from studies.scenes.report import write_scene_report
from studies.scenes.study import CAVEAT, STAGES, RateStudy, study_rate, ways
from training.fitting import versions
from training.progress import stages
from training.say import Say

RATE_FOLDER = re.compile(r"(\d+(?:\.\d+)?)hz")


def run(
    folder: Path, out: Path, seed: int, say: Say, chosen: dict[str, Candidate] | None = None
) -> dict[str, Any]:
    """Study every rate of a folder and write the report; returns what scenes.json holds."""
    started = time.perf_counter()
    studies = [study_rate(rate, chosen or ways(), seed, say) for rate in rate_folders(folder)]
    figures = gathered(studies) | {"seed": seed, "host": asdict(host()), "versions": versions()}
    figures["seconds"] = round(time.perf_counter() - started, 1)
    say("report")
    last = studies[-1]
    write_scene_report(
        out / "report.html", SceneEvidence(figures, last.data, last.held_out, last.streams)
    )
    return figures


def rate_folders(folder: Path) -> list[Path]:
    """The folders <rate>hz of a folder, slowest first. Raises DataNotFound."""
    places = list(folder.iterdir()) if folder.is_dir() else []
    found = [
        (float(match[1]), path) for path in places if (match := RATE_FOLDER.fullmatch(path.name))
    ]
    if not found:
        raise DataNotFound(
            "no folder <rate>hz in it",
            where=folder,
            next_step=f"holdfast simulate thesis --rate 150 --out {folder / '150hz' / 'thesis'}",
        )
    return [path for _, path in sorted(found)]


def gathered(studies: Sequence[RateStudy]) -> dict[str, Any]:
    """The figures of all rates; the fastest rate is the headline."""
    rates = {f"{study.figures.rate_hz:g}": study.figures.to_json() for study in studies}
    kinds = {study.data.kind for study in studies}
    return {
        "kind": kinds.pop() if len(kinds) == 1 else "mixed",
        "caveat": CAVEAT,
        "headline_hz": list(rates)[-1],
        "leak": any(study.figures.leak.leak for study in studies),
        "rates": rates,
    }


def leak_lines(figures: dict[str, Any]) -> list[str]:
    """One line for each rate at which the weight leaks."""
    return [
        f"LEAK at {rate} Hz: the weight is known where no signal carries it: eight classes "
        f"{one['eight_class_accuracy']:.3f} (99 %: {between(one['eight_class_accuracy_ci99'])}, "
        f"ceiling {one['ceiling']}), weight within nothing {one['weight_within_nothing']:.3f} "
        f"(99 %: {between(one['weight_within_nothing_ci99'])}, chance 0.5)"
        for rate, one in ((rate, study["leak"]) for rate, study in figures["rates"].items())
        if one["leak"]
    ]


def main(argv: Sequence[str]) -> int:
    """Parse, run, write scenes.json, print the headline."""
    parser = Parser(prog="scenes.py", description="the whole study of simulated scenes")
    parser.add_argument(
        "folder",
        type=path_argument,
        metavar="FOLDER",
        help="holds <rate>hz/thesis and other sets that simulate wrote",
    )
    parser.add_argument("--out", type=path_argument, default=Path("build/scenes"), metavar="DIR")
    parser.add_argument("--seed", type=seed, default=0, metavar="S")
    args: argparse.Namespace = parser.parse_args(argv)
    require_writable(args.out)
    with stages(1 + STAGES * len(rate_folders(args.folder))) as say:
        figures = run(args.folder, args.out, args.seed, say)
    write_whole(args.out / "scenes.json", json.dumps(figures, indent=1, allow_nan=False) + "\n")
    best = figures["rates"][figures["headline_hz"]]["rows"][OURS]["four"]
    lines = [
        f"{figures['kind']}, {figures['headline_hz']} Hz, trials held out: macro F1 over four "
        f"situations {best['macro_f1']:.3f} ({between(best['macro_f1_ci'])})",
        *leak_lines(figures),
        f"{args.out / 'scenes.json'}, {args.out / 'report.html'} ({figures['seconds']} s)",
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(finish(main, sys.argv[1:]))
