"""The report of `holdfast check` as lines for people."""

from __future__ import annotations

import re
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from holdfast.training.figures import in_words as counted

if TYPE_CHECKING:
    from holdfast.training.check import Cell, ClassSeconds, FolderReport
    from holdfast.training.datasets.trials import Missing

LEVELS = {
    "error": "ERROR",
    "doubt": "DOUBTFUL",
    "training": "FOR TRAINING",
    "advice": "ADVICE",
}
FORMATS = {"thesis": "folders of CSV trials", "recorded": "folders of holdfast record"}
"""Layouts in words; any other is a public set."""
HEADS = ("person", "object", "action", "trials", "Hz", "unit", "mass, g", "labels by")
CLASS_HEADS = ("situation", "light, s", "heavy, s", "mass unknown, s")


def report_lines(report: FolderReport) -> list[str]:
    """The report as lines for people."""
    lines = [f"{report.folder}: no recording can be read"]
    if report.held_out_by is not None:
        lines = _summary(report, report.held_out_by)
    if report.cells:
        lines += ["", *_aligned([HEADS, *map(_row, report.cells)])]
    if report.classes:
        lines += ["", *_aligned([CLASS_HEADS, *map(_class_row, report.classes)])]

    # One line for many faults of a kind: a folder of a hundred trials would fill the screen.
    for first, *others in _kinds(report.missing):
        lines += ["", f"{LEVELS[first.level]} {first.where}: {first.what}"]
        lines.append(f"  -> {first.next_step}")
        if others:
            places = [one.where.removeprefix(f"{report.folder}/") for one in others]
            named = f": {', '.join(places)}" if first.level == "error" else ""
            lines.append(f"  {len(others)} more like it{named}")

    verdict = "ready for holdfast train and holdfast evaluate"
    if report.doubtful:
        verdict += ", but their figures are wrong if what is DOUBTFUL is"
    if not report.readable:
        verdict = "not ready: correct each ERROR, then run holdfast check again"
    elif not report.trainable:
        needs = "holdfast train needs what FOR TRAINING says"
        verdict = f"ready for holdfast evaluate; {needs}"
    elif report.layout not in FORMATS:
        verdict = "a public set, read as it is"

    return [*lines, "", verdict]


def _kinds(missing: Sequence[Missing]) -> list[list[Missing]]:
    """Those of a kind together, in order of first sight."""
    # Numbers are left out of the comparison: "at 49 Hz" and "at 51 Hz" are the same fault.
    found: dict[str, list[Missing]] = {}
    for one in missing:
        kind = re.sub(r"[0-9.]+", "#", f"{one.level} {one.what}")
        found.setdefault(kind, []).append(one)

    return list(found.values())


def _summary(report: FolderReport, held_out_by: str) -> list[str]:
    """The first lines of a report: how much was read, and what is held out together."""
    trials = 0
    seconds = 0.0
    people = set()
    for cell in report.cells:
        trials += cell.trials
        seconds += cell.seconds
        people.add(cell.person)

    people.discard(None)
    of = f" of {counted(len(people), 'person')}" if people else ""
    found = f"{counted(trials, 'trial')}{of}, {seconds / 60.0:.1f} min"
    form = FORMATS.get(report.layout or "", "a public set")
    return [
        f"{report.folder}: {found}, {report.channels} channels; {form}",
        f"held out by {held_out_by}: {counted(report.groups, held_out_by)}",
        *report.not_held_out,
    ]


def _row(cell: Cell) -> tuple[str, ...]:
    """A cell as texts, one for each of HEADS; what is not known is "-"."""
    unread = cell.trials - cell.read
    mass = "-"
    if cell.mass_g is not None:
        mass = f"{cell.mass_g:g} ({Path(cell.mass_from or '').name})"
    return (
        cell.person or "-",
        cell.object_name or "hand alone",
        cell.action or "-",
        f"{cell.trials} ({unread} unread)" if unread else f"{cell.trials}",
        f"{cell.rate_hz:.4g}" if cell.rate_hz else "-",
        cell.unit or "-",
        mass,
        ", ".join(cell.labels_by) or "-",
    )


def _class_row(row: ClassSeconds) -> tuple[str, ...]:
    seconds = (row.light_s, row.heavy_s, row.unweighed_s)
    return row.situation, *map("{:.1f}".format, seconds)


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of texts as lines, each column as wide as its widest text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [f"{cell:<{n}}" for cell, n in zip(row, widths, strict=True)]
        lines.append("  ".join(cells).rstrip())

    return lines
