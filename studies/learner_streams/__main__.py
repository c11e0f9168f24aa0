"""`python -m studies.learner_streams FOLDER --out DIR`: learner-streams.json."""

from __future__ import annotations

import argparse
import json
import sys
from collections.abc import Sequence
from dataclasses import asdict

from holdfast.cli.command import run_script
from holdfast.core.writing import require_writable, write_whole
from holdfast.evaluation.provenance import host
from holdfast.training.progress import stages
from studies.folder_arguments import add_folder_arguments
from studies.learner_streams.figures import LearnerRow
from studies.learner_streams.study import PLANS, study


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this command."""
    add_folder_arguments(parser, "learner-streams")


def run(args: argparse.Namespace) -> int:
    """Study, write, print the main columns."""
    require_writable(args.out)
    path = args.out / "learner-streams.json"

    def keep(rows: Sequence[LearnerRow]) -> None:
        figures = {"kind": "simulated", "seed": args.seed, "host": asdict(host())}
        content = figures | {"rows": [row.to_json() for row in rows]}
        write_whole(path, json.dumps(content, indent=1, allow_nan=False) + "\n")

    with stages(len(PLANS)) as say:
        rows = study(args.folder, args.seed, say, keep=keep)
    keep(rows)
    lines = [
        f"{row.unseen.recall:.3f} {row.step_us:6.1f} us  {row.name}" for row in rows
    ]
    sys.stdout.write("\n".join([*lines, str(path)]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(
        run_script(
            "python -m studies.learner_streams", str(__doc__), add_arguments, run
        )
    )
