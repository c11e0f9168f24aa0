"""`python -m studies.fast_handover FOLDER --out DIR`: writes figures.json."""

from __future__ import annotations

import argparse
import json
import sys

from holdfast.cli.command import run_script
from holdfast.core.writing import require_writable, write_whole
from holdfast.training.progress import stages
from studies.fast_handover.ideas import IDEAS
from studies.fast_handover.study import study
from studies.folder_arguments import add_folder_arguments


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this command."""
    add_folder_arguments(parser, "fast-handover")


def run(args: argparse.Namespace) -> int:
    """Study, write, print the main columns."""
    require_writable(args.out)
    with stages(len(IDEAS)) as say:
        figures = study(args.folder, args.seed, say)
    text = json.dumps(figures.to_json(), indent=1) + "\n"
    path = write_whole(args.out / "figures.json", text)
    lines = [
        " ".join(f"{one.f1:.3f}" for one in row.windows.values()) + f"  {row.idea}"
        for row in figures.rows
    ]
    sys.stdout.write("\n".join([*lines, str(path)]) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(
        run_script("python -m studies.fast_handover", str(__doc__), add_arguments, run)
    )
