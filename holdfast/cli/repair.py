"""`holdfast repair DIR`: repairs trials that a kill or a power cut interrupted.

An incomplete last line of tactile.csv or events.jsonl is moved to tactile.csv.torn or
events.jsonl.torn. The state `recording` becomes `interrupted`, or `void` where the trial ended
before its header was written. A file whose header and rows disagree is refused and not changed.
"""

from __future__ import annotations

import argparse

from holdfast.cli.command import add_json_option, path_argument, show_found
from holdfast.core.errors import DataError, OutputError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    folder = "a trial's folder, or one with trials in it"
    parser.add_argument("folder", type=path_argument, metavar="DIR", help=folder)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Repair every trial below the folder, with a line each.

    Returns the exit code of the last error where one could not be repaired: 3, or 5 on a full disk.
    """
    from holdfast.sessions.recorder.folder import all_trials, alone, repair

    code = 0
    trials = []
    # A recording that is under way looks like an interrupted one.
    with alone(args.folder):
        for folder in all_trials(args.folder):
            try:
                done = ", ".join(repair(folder)) or "complete"
            # One trial that cannot be repaired must not keep the others from it.
            except (DataError, OutputError) as error:
                done = f"not repaired: {error}"
                code = error.exit_code
            trials.append({"folder": folder, "done": done})

    words = "\n".join(f"{one['folder']}: {one['done']}" for one in trials)
    show_found(args, words, {"trials": trials})
    return code
