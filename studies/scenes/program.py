"""`python -m studies scenes`: writes scenes.json and report.html.

It simulates thesis, apple, p1 and p2 at three rates into DIR/<rate>hz/<scene>, unless --sets names
a folder that has such sets already. Everything here is simulated, and says so.
"""

from __future__ import annotations

import argparse
import re
import sys
import time
from collections.abc import Sequence
from pathlib import Path

from holdfast.core.errors import DataNotFound
from holdfast.core.writing import require_writable
from holdfast.evaluation.formats import number
from holdfast.evaluation.window_scores import LeakCheck
from holdfast.training.fitting import versions
from holdfast.training.progress import Say, stages
from studies.report import edges
from studies.row_names import OURS
from studies.scenes.figures import MadeBy, ScenesFigures, scores_of
from studies.scenes.report import SceneEvidence, write_scene_report
from studies.scenes.study import CAVEAT, STAGES, RateStudy, study_rate, ways
from studies.stream_sets import add_sets_option, sets_folder
from tools.harness import SimulatedSet, write_figures

SETS = [
    SimulatedSet(f"{rate_hz}hz/{scene}", scene, rate_hz=rate_hz)
    for rate_hz in (50, 100, 150)
    for scene in ("thesis", "apple", "p1", "p2")
]
RATE_FOLDER = re.compile(r"(\d+(?:\.\d+)?)hz")


def study_rates(
    folder: Path, out: Path, seed: int, say: Say
) -> tuple[ScenesFigures, MadeBy]:
    """Study every rate of a folder and write the report."""
    started = time.perf_counter()
    studies = [study_rate(rate, ways(), seed, say) for rate in rate_folders(folder)]
    figures = gathered(studies)
    last = studies[-1]
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
        f"{number(one.eight_class_accuracy, 3)} (99 %: {edges(one.eight_class_accuracy_ci99)}, "
        f"ceiling {one.ceiling}), weight within nothing {number(one.weight_within_nothing, 3)} "
        f"(99 %: {edges(one.weight_within_nothing_ci99)}, chance 0.5)"
    )


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_sets_option(parser)


def run(args: argparse.Namespace) -> int:
    """Study every rate, write scenes.json, print the headline."""
    require_writable(args.out)
    folder = sets_folder(args.sets, SETS, args.out / "sets")
    with stages(1 + STAGES * len(rate_folders(folder))) as say:
        figures, made = study_rates(folder, args.out, args.seed, say)
    provenance = {
        "seed": made.seed,
        "versions": made.versions,
        "seconds": made.seconds,
    }
    path = write_figures(args.out / "scenes.json", figures.to_json() | provenance)
    best = scores_of(figures.rates[figures.headline_hz].rows, OURS).four
    lines = [
        f"{figures.kind}, {figures.headline_hz} Hz, trials held out: macro F1 over four "
        f"situations {number(best.macro_f1, 3)} ({edges(best.macro_f1_ci)})",
        *leak_lines(figures),
        f"{path}, {args.out / 'report.html'} ({made.seconds} s)",
    ]
    sys.stdout.write("\n".join(lines) + "\n")
    return 0
