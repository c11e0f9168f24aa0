"""`holdfast import`: logs of other programs become trials.

holdfast import logs --out trials                   says what was understood, and asks
holdfast import logs --out trials --yes --action slip
holdfast import logs --out trials --map lab.toml
"""

from __future__ import annotations

import argparse
import sys
from typing import TYPE_CHECKING, NoReturn

from holdfast.cli.command import (
    add_json_option,
    add_out_option,
    path_argument,
    positive,
    require_outputs,
    show,
    show_found,
)
from holdfast.core.errors import DataError, LibraryMissing, UsageError, command
from holdfast.core.writing import require_new, whole_folder, write_whole

if TYPE_CHECKING:
    from holdfast.core.progress import Part
    from holdfast.interop.proposal import Proposal

ANSWERS = {
    "action": (
        "ACTION",
        "what happens in the trials: slip, hold, pull, ..; or WORD=ACTION,WORD=ACTION",
    ),
    "person": ("NAME", "who holds, or which names in the paths are people"),
    "object": ("NAME", "what is held, in the same way"),
    "unit": ("UNIT", "of the readings: N, mN, lbf, uT, .."),
    "fingers": (
        "WORDS",
        "words of the files of one trial, a file for each finger, in their order",
    ),
    "labels": ("NAME", "the column, or the table of events, that says when it slips"),
    "sensors": (
        "COLUMNS",
        "x, y, z of each sensor in turn, such as 'ch*' or 'left_f*'",
    ),
}
"""Option that answers a question -> what it takes, and its help."""
PICTURE = "first-trial.svg"
"""In the set: the first trial over its time, with its labels."""


def add_import_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "source",
        type=path_argument,
        metavar="SOURCE",
        help="a text table, xlsx, MCAP, Parquet, XDF, rosbag2 or LeRobot, or a folder of them",
    )
    add_out_option(parser)
    option(
        "--map",
        type=path_argument,
        metavar="MAP.toml",
        help="column map (docs/your-data.md); without it one is found",
    )
    option("--yes", action="store_true", help="take what was understood without asking")
    for name, (takes, about) in ANSWERS.items():
        option(f"--{name}", default="", metavar=takes, help=about)
    option(
        "--rate",
        type=positive,
        metavar="HZ",
        help="rows a second, where no column says it",
    )
    option("--unwrap", action="store_true", help="take out jumps of readings by 2^16")
    option("--normal", default="", choices=("x", "y", "z"), help="the axis of a press")
    add_json_option(parser)


def run_import(args: argparse.Namespace) -> int:
    """Say what was understood, ask what is left, then write all trials, or none."""
    from holdfast.core.progress import Stages

    require_new(args.out)
    require_outputs(args, folder=args.out)
    begin = Stages()
    begin(f"looking at {args.source}")
    found = _understood(args, begin.part)
    from holdfast.interop.formats.writing import write_beside
    from holdfast.interop.trials import TrialImport
    from holdfast.training.check import examine, report_lines

    with whole_folder(args.out) as folder:
        begin(f"writing {args.out}")
        reading = TrialImport(folder, found.kept)
        for plan, files in found.plans:
            reading.take(args.source, plan, files, begin.part)
        write_beside(folder, found.plans[0][0], args.map or args.out, reading.written)
        reading.report(found)
        # nothing is kept where the block is left by an error
        if not args.yes and args.map is None:
            show("\n".join(found.lines))
            if _typed("import this? [y/N]").lower() not in ("y", "yes"):
                _refuse(args, found, "no trial is written yet", "--yes")

    checked = examine(args.out)
    first, *between, verdict = report_lines(checked)
    doubts = [line for line in between if line.startswith("DOUBTFUL")]
    shown = [*found.lines, "", *_picture(args), first, *doubts, verdict]
    is_ready = checked.levels <= {"advice"}
    next_words = ("train", "--data") if is_ready else ("check",)
    shown.append(f"next: {command(*next_words, args.out)}")
    words = {"understood": found.lines, "notes": reading.notes}
    figures = {"out": str(args.out), "trials": reading.written, **words}
    show_found(args, "\n".join(shown), figures)
    return 0


def _understood(args: argparse.Namespace, part: Part) -> Proposal:
    """What the logs are, with every question answered. Raises UsageError where one is left."""
    from holdfast.interop.map import read_import_map
    from holdfast.interop.proposal import Answers
    from holdfast.interop.understand import of_map, understand

    if args.map is not None:
        return of_map(args.source, read_import_map(args.map))
    while True:
        given = {
            key: getattr(args, key) for key in (*ANSWERS, "rate", "normal", "unwrap")
        }
        found = understand(args.source, Answers(**given), part)
        if not found.questions:
            return found
        show("\n".join(found.lines))
        option, text = found.questions[0]
        key = option.removeprefix("--")
        typed = "" if args.yes or key not in given else _typed(text)
        if not typed:
            # all at once, so that the next command is the last one
            options, asked = zip(*found.questions, strict=True)
            _refuse(args, found, "; ".join(asked), " .. ".join([*options, ""]).strip())
        setattr(args, key, positive(typed) if key == "rate" else typed)


def _typed(question: str) -> str:
    """What a person answers on a terminal; "" without one."""
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        return ""
    show(question)
    return input("> ").strip()


def _refuse(
    args: argparse.Namespace, found: Proposal, what: str, options: str
) -> NoReturn:
    """Write the map for the next time, unless it was changed by hand. Raises UsageError."""
    from holdfast.interop.map import is_changed, map_text

    path = args.out.with_name(f"{args.out.name}-map.toml")
    if found.plans and is_changed(path):
        show(f"{path}: was changed by hand, and stays; use it: --map {path}")
    elif found.plans:
        write_whole(path, map_text(found.plans[0][0]))
        show(f"{path}: what is known so far, as a map")
    again = command("import", args.source, "--out", args.out)
    raise UsageError(what, next_step=f"{again} {options}")


def _picture(args: argparse.Namespace) -> list[str]:
    """Draw the first trial, where matplotlib is there and a trial can be read; in words."""
    from holdfast.data.datasets.thesis import readers

    try:
        from holdfast.evaluation.pictures import trial

        first = readers(args.out)[0].read().recording
    except (LibraryMissing, DataError):
        return []
    write_whole(args.out / PICTURE, trial(first, "imported"))
    return [f"picture of {first.trial_id}: {args.out / PICTURE}"]
