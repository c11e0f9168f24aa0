"""`holdfast repair DIR`: repairs trials that a kill or a power cut interrupted.

An incomplete last line of tactile.csv or events.jsonl is moved to tactile.csv.torn or
events.jsonl.torn. The state `recording` becomes `interrupted`, or `void` where the trial ended
before its header was written. A file whose header and rows disagree is refused and not changed.
"""

from __future__ import annotations

import argparse

from holdfast.edge_runtime.command import path_argument
from holdfast.edge_runtime.errors import DataError, OutputError
from holdfast.edge_runtime.json_option import add_json_option, show_found


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    folder = "a trial's folder, or one with trials in it"
    parser.add_argument("folder", type=path_argument, metavar="DIR", help=folder)
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Repair every trial below the folder, with a line each.

    Returns the exit code of the last error where one could not be repaired: 3, or 5 on a full disk.
    """
    from holdfast.recorder.folder import all_trials, alone
    from holdfast.recorder.mending import repaired

    code, trials = 0, []
    with alone(args.folder):
        for folder in all_trials(args.folder):
            try:
                done = ", ".join(repaired(folder)) or "complete"
            except (DataError, OutputError) as error:
                done, code = f"not repaired: {error}", error.exit_code
            trials.append({"folder": folder, "done": done})
    words = "\n".join(f"{one['folder']}: {one['done']}" for one in trials)
    show_found(args, words, {"trials": trials})
    return code
