"""`holdfast import`: logs of other programs become trials.

holdfast import logs --out trials                   says what was understood, and asks
holdfast import logs --out trials --yes --action slip
holdfast import logs --out trials --map lab.toml
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import TYPE_CHECKING, Any

from holdfast.cli.command import (
    add_json_option,
    path_argument,
    positive,
    show,
    show_found,
)
from holdfast.core.errors import (
    DataError,
    LibraryMissing,
    OutputError,
    UsageError,
)
from holdfast.core.writing import whole_folder, write_whole

if TYPE_CHECKING:
    from holdfast.interop.understood import Understood

MAP_SUFFIX = "-map.toml"
"""Of a map, beside the set that it is for."""
PICTURE = "first-trial.svg"
"""In the set: the first trial over its time, with its labels."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """The options of this verb."""
    option = parser.add_argument
    option(
        "source",
        type=path_argument,
        metavar="SOURCE",
        help="a text table, xlsx, MCAP, Parquet, XDF, rosbag2 or LeRobot, or a folder of them",
    )
    option(
        "--out", type=path_argument, required=True, metavar="DIR", help="a new folder"
    )
    option(
        "--map",
        type=path_argument,
        metavar="MAP.toml",
        help="column map (docs/your-data.md); without it one is found",
    )
    option("--yes", action="store_true", help="take what was understood without asking")
    option(
        "--action",
        default="",
        metavar="ACTION",
        help="what happens in the trials: slip, hold, pull, ..; or WORD=ACTION,WORD=ACTION",
    )
    option(
        "--person",
        default="",
        metavar="NAME",
        help="who holds, or which names in the paths are people",
    )
    option("--object", default="", metavar="NAME", help="what is held, in the same way")
    option("--unit", default="", metavar="UNIT", help="of the readings: N, mN, uT, ..")
    option(
        "--rate",
        type=positive,
        metavar="HZ",
        help="rows a second, where no column says it",
    )
    option("--normal", default="", choices=("x", "y", "z"), help="the axis of a press")
    add_json_option(parser)


def run(args: argparse.Namespace) -> int:
    """Say what was understood, ask what is left, then write all trials, or none."""
    if args.out.exists() and (not args.out.is_dir() or any(args.out.iterdir())):
        raise OutputError(
            "exists and is not empty", where=args.out, next_step="name a new folder"
        )
    found = _understood(args)
    from holdfast.interop.trials import TrialImport
    from holdfast.interop.writing import write_beside
    from holdfast.training.progress import Stages

    with whole_folder(args.out) as folder:
        begin = Stages()
        begin(f"reading {args.source}")
        reading = TrialImport(folder)
        for plan, files in found.plans:
            reading.take(args.source, plan, files, begin.part)
        maps = args.map.parent if args.map else args.out.parent
        write_beside(folder, found.plans[0][0], maps, reading.written)
        lines = [*found.lines, *reading.lines()]
        # nothing is kept where the block is left by an error
        _require_wanted(args, found, lines)
    from holdfast.training.check import examine, report_lines

    first, *_, verdict = report_lines(examine(args.out))
    shown = [*lines, "", *_picture(args.out), first, verdict]
    shown.append(f"next: holdfast check {args.out}")
    words = {"understood": lines, "trials": reading.written, "notes": reading.notes}
    show_found(args, "\n".join(shown), {"out": str(args.out), **words})
    return 0


def _understood(args: argparse.Namespace) -> Understood:
    """What the logs are, with every question answered. Raises UsageError where one is left."""
    from holdfast.interop.map import read_import_map
    from holdfast.interop.understand import of_map, understand
    from holdfast.interop.understood import Answers

    if args.map is not None:
        return of_map(args.source, read_import_map(args.map))
    answers = Answers(
        args.action, args.person, args.object, args.unit, args.rate, args.normal
    )
    found = understand(args.source, answers)
    while found.questions:
        question = found.questions[0]
        show("\n".join(found.lines))
        key = question.option.removeprefix("--")
        if args.yes or not _on_terminal() or not hasattr(answers, key):
            _write_map(args, found)
            # all at once, so that the next command is the last one
            asked = "; ".join(one.text for one in found.questions)
            options = " ".join(f"{one.option} .." for one in found.questions)
            raise UsageError(asked, next_step=f"{_command(args)} {options}")
        show(question.text)
        typed = input("> ").strip()
        answer: dict[str, Any] = {key: float(typed) if key == "rate" else typed}
        answers = replace(answers, **answer)
        found = understand(args.source, answers)
    return found


def _on_terminal() -> bool:
    return sys.stdin.isatty() and sys.stdout.isatty()


def _command(args: argparse.Namespace) -> str:
    return f"holdfast import {args.source} --out {args.out}"


def _write_map(args: argparse.Namespace, found: Understood) -> None:
    """Write the map for the next time, unless it was changed by hand; and say so."""
    from holdfast.interop.map import is_changed, map_text

    path = args.out.with_name(args.out.name + MAP_SUFFIX)
    if found.plans and is_changed(path):
        show(f"{path}: was changed by hand, and stays; use it: --map {path}")
    elif found.plans:
        write_whole(path, map_text(found.plans[0][0]))
        show(f"{path}: what is known so far, as a map")


def _require_wanted(
    args: argparse.Namespace, found: Understood, lines: list[str]
) -> None:
    """Show what was found. Raises UsageError where it is not wanted."""
    if args.yes or args.map is not None:
        return
    show("\n".join(lines))
    if _on_terminal() and input("import this? [y/N] ").strip().lower() in ("y", "yes"):
        return
    _write_map(args, found)
    raise UsageError("no trial is written yet", next_step=f"{_command(args)} --yes")


def _picture(out: Path) -> list[str]:
    """Draw the first trial, where matplotlib is there and a trial can be read; in words."""
    from holdfast.training.datasets.thesis import readers

    try:
        from holdfast.evaluation.pictures import trial

        first = readers(out)[0].read().recording
    except (LibraryMissing, DataError):
        return []
    write_whole(out / PICTURE, trial(first, "imported"))
    return [f"picture of {first.trial_id}: {out / PICTURE}"]
