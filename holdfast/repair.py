"""`holdfast repair DIR`: repairs trials that a kill or a power cut interrupted.

An incomplete last line of tactile.csv or events.jsonl is moved to tactile.csv.torn or
events.jsonl.torn. The state `recording` becomes `interrupted`, or `void` where the trial ended
before its header was written. A file whose header and rows disagree is refused and not changed.
"""

from __future__ import annotations

import argparse

from holdfast.edge_runtime.command import path_argument, show


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    folder = "a trial's folder, or one with trials in it"
    parser.add_argument("folder", type=path_argument, metavar="DIR", help=folder)


def run(args: argparse.Namespace) -> int:
    """Repair every trial below the folder, with a line each.

    Returns the exit code of the last error where one could not be repaired: 3, or 5 on a full disk.
    """
    from holdfast.edge_runtime.errors import DataError, OutputError
    from holdfast.recorder.folder import all_trials, alone
    from holdfast.recorder.mending import repaired

    code = 0
    with alone(args.folder):
        for folder in all_trials(args.folder):
            try:
                show(f"{folder}: {', '.join(repaired(folder)) or 'complete'}")
            except (DataError, OutputError) as error:
                show(f"{folder}: not repaired: {error}")
                code = error.exit_code
    return code
