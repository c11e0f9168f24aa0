"""`holdfast convert`: recordings in the formats of other tools.

holdfast convert trials --to parquet --out trials-parquet
holdfast convert trials --to mcap --out trials-mcap --only 'p01/*'
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Any

from holdfast.cli.command import (
    add_json_option,
    add_out_option,
    path_argument,
    require_outputs,
    show_found,
)
from holdfast.core.errors import LibraryMissing, count_of
from holdfast.core.writing import require_new, whole_folder

WRITERS = {
    "parquet": "holdfast.interop.formats.parquet",
    "mcap": "holdfast.interop.formats.mcap_file",
    "lerobot": "holdfast.interop.formats.lerobot",
}
"""Format -> the module that writes it and alone imports its library."""


def add_convert_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "source",
        type=path_argument,
        metavar="FOLDER",
        help="a folder of recordings; logs of others come in by holdfast import",
    )
    option(
        "--to",
        choices=WRITERS,
        required=True,
        help="format to write (docs/formats.md); each needs the extra of its name",
    )
    add_out_option(parser)
    option(
        "--only",
        default="*",
        metavar="GLOB",
        help="trials whose names match, such as 'p01/*'",
    )
    option("--raw", action="store_true", help="values as recorded, not without bias")
    add_json_option(parser)


def run_convert(args: argparse.Namespace) -> int:
    """Read all trials, then write all of them or nothing."""
    writer = _writer(args.to)
    from holdfast.interop.formats.payload import read_payloads

    # Files of two conversions in one folder could not be told apart.
    require_new(args.out)
    require_outputs(args, folder=args.out)
    trials = read_payloads(args.source, args.only, raw=args.raw)
    # All or nothing: a conversion that fails leaves no folder behind.
    with whole_folder(args.out) as folder:
        writer.write_trials(trials, folder)
    rows = sum(len(trial.t_s) for trial in trials)

    words = f"{args.out}: {count_of(len(trials), 'trial')}, {count_of(rows, 'sample')}"
    show_found(args, words, {"out": args.out, "trials": len(trials), "samples": rows})
    return 0


def _writer(form: str) -> Any:
    """The module of a format. Raises LibraryMissing with the extra of this very format."""
    try:
        return import_module(WRITERS[form])
    except LibraryMissing as error:
        # one writer may use the module of another, whose extra would not be enough
        raise LibraryMissing(
            error.what,
            cause=f"only the extra `{form}` installs it",
            next_step=f"pip install 'holdfast[{form}]'",
        ) from None
