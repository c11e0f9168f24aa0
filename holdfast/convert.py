"""`holdfast convert FOLDER --to FORMAT --out DIR`: recordings in the formats of other tools.

holdfast convert trials --to parquet --out trials-parquet
holdfast convert trials --to mcap --out trials-mcap --only 'p01/*'
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Any

from edge_runtime.command import path_argument, show

WRITERS = {
    "parquet": "holdfast.interop.tables",
    "mcap": "holdfast.interop.mcap_file",
    "ros2": "holdfast.interop.ros2",
    "lerobot": "holdfast.interop.lerobot",
}
"""Format -> the module that writes it and alone imports its library."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option("source", type=path_argument, metavar="FOLDER", help="a folder of recordings")
    formats = "format to write (docs/interop.md); each needs the extra of its name"
    option("--to", choices=[*WRITERS], required=True, help=formats)
    option("--out", type=path_argument, required=True, metavar="DIR", help="a new folder")
    option("--only", default="*", metavar="GLOB", help="trials whose names match, such as 'p01/*'")
    raw = "values as recorded, not without bias"
    option("--raw", action="store_true", help=raw)


def run(args: argparse.Namespace) -> int:
    """Read all trials, then write all of them or nothing."""
    from edge_runtime.errors import OutputError
    from edge_runtime.writing import whole_folder

    writer: Any = import_module(WRITERS[args.to])
    from holdfast.interop.carried import carried_trials

    if args.out.exists() and (not args.out.is_dir() or any(args.out.iterdir())):
        raise OutputError("exists and is not empty", where=args.out, next_step="name a new folder")
    trials = carried_trials(args.source, args.only, raw=args.raw)
    with whole_folder(args.out) as folder:
        writer.write_trials(trials, folder)
    rows = sum(len(trial.t_s) for trial in trials)
    show(f"{args.out}: {len(trials)} trials, {rows} samples")
    return 0
