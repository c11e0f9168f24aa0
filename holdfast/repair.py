"""`holdfast repair DIR`: mend trials that a kill or a power cut broke off, and say what was done.

A torn last line of tactile.csv or events.jsonl is moved to tactile.csv.torn or events.jsonl.torn. A
trial that still says `recording` says `interrupted` from then on, or `void` where it ended before
its header was written. A file whose header and rows disagree is refused, and stays as it is.
"""

from __future__ import annotations

import argparse

from edge_runtime.command import path_argument, show


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    parser.add_argument(
        "folder",
        type=path_argument,
        metavar="DIR",
        help="a trial's folder, or one with trials in it",
    )


def run(args: argparse.Namespace) -> int:
    """Mend every trial below the folder; a line each, and the exit code of data where one could not
    be."""
    from edge_runtime.errors import DataError
    from holdfast.recorder.folder import all_trials, alone
    from holdfast.recorder.mending import repaired

    code = 0
    with alone(args.folder):
        for folder in all_trials(args.folder):
            try:
                show(f"{folder}: {', '.join(repaired(folder)) or 'whole'}")
            except DataError as error:
                show(f"{folder}: not mended: {error}")
                code = error.exit_code
    return code
