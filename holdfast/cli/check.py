"""`holdfast check FOLDER`: what a folder of recordings holds, what is missing, what to write where.

It reads every trial and goes on after a fault. Exit code 0 if `holdfast evaluate` can read the
folder, else 3.
"""

from __future__ import annotations

import argparse
from pathlib import Path

from holdfast.cli.command import add_json_option, show, show_found
from holdfast.core.errors import DataError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "folder",
        metavar="FOLDER|SET",
        help="a folder of recordings, or a public set by name",
    )
    add_json_option(parser)
    example = (
        "write the files of docs/your-data.md into FOLDER, which must be new, and stop"
    )
    option("--example", action="store_true", help=example)


def run(args: argparse.Namespace) -> int:
    """Examine the folder and print the report."""
    # The folder is written here and not read.
    if args.example:
        return _write_example(Path(args.folder))
    from holdfast.training.check import examine, report_lines
    from holdfast.training.datasets import find
    from holdfast.training.progress import stages

    with stages(1) as begin:
        begin(f"reading {args.folder}")
        report = examine(find(args.folder), begin.part)

    show_found(args, "\n".join(report_lines(report)), report.to_json())
    return 0 if report.readable else DataError.exit_code


def _write_example(folder: Path) -> int:
    from holdfast.training.fixture import LOGGER, TRIALS, write_example

    write_example(folder)
    show(
        f"{folder / TRIALS}: trials of three people, to check; {folder / LOGGER}: a log to convert"
    )
    return 0
