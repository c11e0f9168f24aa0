"""`python -m studies learner-streams`: writes learner-streams.json."""

from __future__ import annotations

import argparse
import sys
from collections.abc import Sequence

from holdfast.core.writing import require_writable
from holdfast.training.progress import stages
from studies.learner_streams.figures import LearnerRow
from studies.learner_streams.study import PLANS, study
from studies.stream_sets import STREAMS, add_sets_option, sets_folder
from tools.harness import SimulatedSet, write_figures

SETS = [*STREAMS, SimulatedSet("asked-daily", "daily", 370, 1006)]


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this study alone."""
    add_sets_option(parser)


def run(args: argparse.Namespace) -> int:
    """Study, write, print the main columns."""
    require_writable(args.out)
    folder = sets_folder(args, SETS)
    path = args.out / "learner-streams.json"

    def keep(rows: Sequence[LearnerRow]) -> None:
        content = [row.to_json() for row in rows]
        write_figures(path, {"kind": "simulated", "seed": args.seed, "rows": content})

    # kept after every learner: the study takes hours
    with stages(len(PLANS)) as say:
        rows = study(folder, args.seed, say, keep=keep)
    keep(rows)
    for row in rows:
        sys.stdout.write(f"{row.unseen.recall:.3f} {row.step_us:6.1f} us  {row.name}\n")
    sys.stdout.write(f"{path}\n")
    return 0
