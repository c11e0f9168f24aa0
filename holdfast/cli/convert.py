"""`holdfast convert`: recordings in the formats of other tools, and XDF into the trial layout.

holdfast convert trials --to parquet --out trials-parquet
holdfast convert trials --to mcap --out trials-mcap --only 'p01/*'
holdfast convert session.xdf --to trials --out trials --person p01 --object cup --action pull
"""

from __future__ import annotations

import argparse
from importlib import import_module
from typing import Any

from holdfast.cli.command import add_json_option, path_argument, show_found
from holdfast.core.contract import UNITS
from holdfast.core.errors import LibraryMissing, OutputError, UsageError, count_of

WRITERS = {
    "parquet": "holdfast.interop.tables",
    "mcap": "holdfast.interop.mcap_file",
    "lerobot": "holdfast.interop.lerobot",
}
"""Format -> the module that writes it and alone imports its library."""
TRIALS = "trials"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    source = "a folder of recordings; an XDF file for --to trials"
    option("source", type=path_argument, metavar="FOLDER|XDF", help=source)
    formats = "format to write (docs/interop.md); each needs the extra of its name"
    option("--to", choices=[*WRITERS, TRIALS], required=True, help=formats)
    out = "a new folder; for trials also an existing set"
    option("--out", type=path_argument, required=True, metavar="DIR", help=out)
    option(
        "--only",
        default="*",
        metavar="GLOB",
        help="trials whose names match, such as 'p01/*'",
    )
    raw = "values as recorded, not without bias"
    option("--raw", action="store_true", help=raw)
    add_json_option(parser)
    xdf = parser.add_argument_group("an XDF file into trials").add_argument
    xdf(
        "--person",
        metavar="PSEUDONYM",
        help="letters, digits, dashes; never a real name",
    )
    xdf(
        "--object", metavar="NAME", help="without markers that begin trials: the object"
    )
    xdf("--action", metavar="ACTION", help="the same: the action, such as pull")
    xdf(
        "--stream",
        metavar="NAME",
        help="the tactile stream (default: the only one that fits)",
    )
    xdf("--unit", choices=UNITS, help="of the stream, where it does not say")


def run(args: argparse.Namespace) -> int:
    """Read all trials, then write all of them or nothing."""
    return _from_xdf(args) if args.to == TRIALS else _to_format(args)


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


def _to_format(args: argparse.Namespace) -> int:
    from holdfast.core.writing import whole_folder

    writer = _writer(args.to)
    from holdfast.interop.payload import read_payloads

    # Files of two conversions in one folder could not be told apart.
    if args.out.exists() and (not args.out.is_dir() or any(args.out.iterdir())):
        raise OutputError(
            "exists and is not empty", where=args.out, next_step="name a new folder"
        )

    trials = read_payloads(args.source, args.only, raw=args.raw)
    # All or nothing: a conversion that fails leaves no folder behind.
    with whole_folder(args.out) as folder:
        writer.write_trials(trials, folder)
    rows = sum(len(trial.t_s) for trial in trials)

    words = f"{args.out}: {count_of(len(trials), 'trial')}, {count_of(rows, 'sample')}"
    show_found(args, words, {"out": args.out, "trials": len(trials), "samples": rows})
    return 0


def _from_xdf(args: argparse.Namespace) -> int:
    from holdfast.core.trial_layout import checked_name
    from holdfast.interop.xdf import cuts, read_xdf, write_trials

    if not args.person:
        raise UsageError("--to trials without a person", next_step="--person p01")
    # Names of people become folders, so they are checked like those of the recorder.
    person = args.out / checked_name(args.person, "--person")
    named = (
        f"{args.object}/{args.action}" if args.object and args.action else args.action
    )

    stream, markers = read_xdf(args.source, args.stream, args.unit)
    found = cuts(markers, named, args.source)
    written = [str(path) for path in write_trials(stream, markers, found, person)]
    words = "\n".join([*written, f"next: holdfast check {args.out}"])
    show_found(args, words, {"out": args.out, "trials": written})
    return 0
