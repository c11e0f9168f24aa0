"""`python -m studies fast-handover`: writes figures.json."""

from __future__ import annotations

import argparse
import sys

from holdfast.core.writing import require_writable
from holdfast.training.progress import stages
from studies.fast_handover.ideas import IDEAS
from studies.fast_handover.study import study
from studies.stream_sets import STREAMS, add_sets_option, sets_folder
from tools.harness import SimulatedSet, write_figures

SETS = [
    *STREAMS,
    SimulatedSet("daily", "daily", 200, 3),
    SimulatedSet("holds", "perturbed-hold", 150, 4),
]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_sets_option(parser)


def run(args: argparse.Namespace) -> int:
    """Study, write, print the main columns."""
    require_writable(args.out)
    folder = sets_folder(args, SETS)
    with stages(len(IDEAS)) as say:
        figures = study(folder, args.seed, say)
    path = write_figures(args.out / "figures.json", figures.to_json())
    for row in figures.rows:
        scores = [f"{one.f1:.3f}" for one in row.windows.values()]
        sys.stdout.write(f"{' '.join(scores)}  {row.idea}\n")
    sys.stdout.write(f"{path}\n")
    return 0
