"""`holdfast check FOLDER`: what a folder of recordings holds, what is missing, what to write where.

It reads every trial and goes on after a fault. Exit code 0 if `holdfast evaluate` can read the
folder, else 3.

--repair ends what a kill or a power cut left of trials. An incomplete last line of tactile.csv or
events.jsonl is moved to tactile.csv.torn or events.jsonl.torn. The state `recording` becomes
`interrupted`, or `void` where the trial ended before its header was written. A file whose header
and rows disagree is refused and not changed.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from holdfast.cli.command import add_json_option, show, show_found
from holdfast.core.errors import DataError, OutputError


def add_check_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "folder",
        metavar="FOLDER|SET",
        help="a folder of recordings, or a public set by name",
    )
    add_json_option(parser)
    option(
        "--repair",
        action="store_true",
        help="repair trials that a kill or a power cut interrupted, and stop",
    )
    option(
        "--example",
        action="store_true",
        help="write the files of docs/your-data.md into FOLDER, which must be new, and stop",
    )


def run_check(args: argparse.Namespace) -> int:
    """Examine the folder and print the report."""
    # The folder is written here and not read.
    if args.example:
        return _write_example(Path(args.folder))
    if args.repair:
        return _repair(args)
    from holdfast.cli.options import read_settings, settings_file
    from holdfast.core.progress import Stages
    from holdfast.data.datasets import find
    from holdfast.training.check import examine, report_lines

    begin = Stages()
    begin(f"reading {args.folder}")
    settings = read_settings(settings_file([]))
    report = examine(find(args.folder), settings.get("ceiling_n"))
    show_found(args, "\n".join(report_lines(report)), report.to_json())
    return 0 if report.readable else DataError.exit_code


def _repair(args: argparse.Namespace) -> int:
    """Repair every trial below the folder, with a line each.

    Returns the exit code of the last error where one could not be repaired: 3, or 5 on a full disk.
    """
    from holdfast.sessions.recorder.folder import all_trials, folder_lock, repair

    root = Path(args.folder)
    code = 0
    trials = []
    # A recording that is under way looks like an interrupted one.
    with folder_lock(root):
        for folder in all_trials(root):
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


def _write_example(folder: Path) -> int:
    from holdfast.data.fixture import LOGGER, TRIALS, write_example

    write_example(folder)
    show(
        f"{folder / TRIALS}: trials of three people, to check; {folder / LOGGER}: a log to convert"
    )
    return 0
