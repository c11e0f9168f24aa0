"""`holdfast check FOLDER`: what a folder of recordings holds, what is missing, what to write where.

It reads every trial and goes on after a fault. Exit code 0 if `holdfast evaluate` can read the
folder, else 3.
"""

from __future__ import annotations

import argparse
import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.cli.command import add_json_option, show, show_found
from holdfast.core.errors import DataError

if TYPE_CHECKING:
    from holdfast.training.folder_check import Cell, FolderReport, Missing

HEADS = ("person", "object", "action", "trials", "Hz", "unit", "mass, g", "labels by")
CLASS_HEADS = ("situation", "light, s", "heavy, s")
FORMATS = {"thesis": "folders of CSV trials", "recorded": "folders of holdfast record"}
NUMBER = re.compile(r"[0-9.]+")
HAND_ALONE = "hand alone"
LEVELS = {"error": "ERROR", "training": "FOR TRAINING", "advice": "ADVICE"}


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
    if args.example:
        return _write_example(Path(args.folder))
    from holdfast.training.datasets import find
    from holdfast.training.folder_check import examine
    from holdfast.training.progress import stages

    with stages(1) as say:
        say(f"reading {args.folder}")
        report = examine(find(args.folder), say.part)
    show_found(args, "\n".join(in_words(report)), report.to_json())
    return 0 if report.readable else DataError.exit_code


def _write_example(folder: Path) -> int:
    from holdfast.training.fixture import LOGGER, TRIALS, write_example

    write_example(folder)
    show(
        f"{folder / TRIALS}: trials of three people, to check; {folder / LOGGER}: a log to convert"
    )
    return 0


def in_words(report: FolderReport) -> list[str]:
    """The report as lines for people."""
    lines = _summary(report)
    if report.cells:
        lines += ["", *_aligned([HEADS, *map(_row, report.cells)])]
    if report.classes:
        rows = [
            (one.situation, f"{one.light_s:.1f}", f"{one.heavy_s:.1f}")
            for one in report.classes
        ]
        lines += ["", *_aligned([CLASS_HEADS, *rows])]
    for one, more in _alike(report.missing):
        lines += [
            "",
            f"{LEVELS[one.level]} {one.where}: {one.what}",
            f"  -> {one.next_step}",
        ]
        lines += [f"  {more} more like it"] if more else []
    return [*lines, "", _verdict(report)]


def _alike(missing: Sequence[Missing]) -> list[tuple[Missing, int]]:
    """The first of those that differ only in place and numbers, and how many more there are."""
    alike: dict[tuple[str, str], list[Missing]] = {}
    for one in missing:
        alike.setdefault((one.level, NUMBER.sub("#", one.what)), []).append(one)
    return [(ones[0], len(ones) - 1) for ones in alike.values()]


def _summary(report: FolderReport) -> list[str]:
    from holdfast.training.figures import in_words as counted

    if report.layout is None or report.held_out_by is None:
        return [f"{report.folder}: no recording can be read"]
    trials, people = (
        sum(one.trials for one in report.cells),
        {one.person for one in report.cells},
    )
    minutes = sum(one.seconds for one in report.cells) / 60.0
    n_people = len(people - {None})
    own = f"the wearer's own command beside {counted(report.intents, 'trial')}"
    of = f" of {counted(n_people, 'person')}" if n_people else ""
    return [
        f"{report.folder}: {counted(trials, 'trial')}{of}, {minutes:.1f} min, "
        f"{report.channels} channels; {FORMATS.get(report.layout, 'a public set')}",
        f"held out by {report.held_out_by}: {counted(report.groups, report.held_out_by)}",
        *([own] if report.intents else []),
    ]


def _row(cell: Cell) -> tuple[str, ...]:
    unread = cell.trials - cell.read
    mass = (
        "-"
        if cell.mass_g is None
        else f"{cell.mass_g:g} ({Path(cell.mass_from or '').name})"
    )
    labels = ", ".join(
        name if len(cell.labels_by) == 1 else f"{name}: {count}"
        for name, count in cell.labels_by.items()
    )
    return (
        cell.person or "-",
        cell.object_name or HAND_ALONE,
        cell.action or "-",
        f"{cell.trials}" + (f" ({unread} unread)" if unread else ""),
        "-" if cell.rate_hz is None else f"{cell.rate_hz:.4g}",
        cell.unit or "-",
        mass,
        labels or "-",
    )


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    return [
        "  ".join(
            f"{cell:<{width}}" for cell, width in zip(row, widths, strict=True)
        ).rstrip()
        for row in rows
    ]


def _verdict(report: FolderReport) -> str:
    if report.layout not in (None, *FORMATS):
        return "a public set, read as it is"
    if not report.readable:
        return "not ready: correct each ERROR, then run holdfast check again"
    if not report.trainable:
        return (
            "ready for holdfast evaluate; holdfast train needs what FOR TRAINING says"
        )
    return "ready for holdfast train and holdfast evaluate"
