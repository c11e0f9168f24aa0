"""The report of `holdfast check` as lines for people."""

from __future__ import annotations

import re
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import TypeVar

from holdfast.training.figures import in_words as counted
from holdfast.training.folder_advice import ClassSeconds, Missing
from holdfast.training.folder_check import Cell, FolderReport

HEADS = ("person", "object", "action", "trials", "Hz", "unit", "mass, g", "labels by")
CLASS_HEADS = ("situation", "light, s", "heavy, s", "mass unknown, s")
FORMATS = {"thesis": "folders of CSV trials", "recorded": "folders of holdfast record"}
"""Layouts in words; any other is a public set."""
NUMBER = re.compile(r"[0-9.]+")
"""Left out where faults are compared."""
HAND_ALONE = "hand alone"
T = TypeVar("T")
LEVELS = {"error": "ERROR", "training": "FOR TRAINING", "advice": "ADVICE"}


def report_lines(report: FolderReport) -> list[str]:
    """The report as lines for people."""
    lines = _summary(report)
    if report.cells:
        lines += ["", *_aligned([HEADS, *map(_row, report.cells)])]
    if report.classes:
        lines += ["", *_aligned(_class_rows(report.classes))]

    # One line for many faults of a kind: a folder of a hundred trials would fill the screen.
    for first, more in alike(report.missing, _words):
        lines += ["", f"{LEVELS[first.level]} {first.where}: {first.what}"]
        lines.append(f"  -> {first.next_step}")
        if more:
            lines.append(f"  {more} more like it")
    return [*lines, "", _verdict(report)]


def alike(ones: Sequence[T], words: Callable[[T], str]) -> list[tuple[T, int]]:
    """The first of those whose words differ in numbers alone, and how many more there are."""
    # Numbers are left out of the comparison: "at 49 Hz" and "at 51 Hz" are the same fault.
    found: dict[str, list[T]] = {}
    for one in ones:
        found.setdefault(NUMBER.sub("#", words(one)), []).append(one)
    return [(group[0], len(group) - 1) for group in found.values()]


def _words(missing: Missing) -> str:
    return f"{missing.level} {missing.what}"


def _summary(report: FolderReport) -> list[str]:
    """The first lines of a report: how much was read, and what is held out together."""
    if report.layout is None or report.held_out_by is None:
        return [f"{report.folder}: no recording can be read"]

    trials = sum(cell.trials for cell in report.cells)
    minutes = sum(cell.seconds for cell in report.cells) / 60.0
    n_people = len({cell.person for cell in report.cells} - {None})
    of = f" of {counted(n_people, 'person')}" if n_people else ""
    lines = [
        f"{report.folder}: {counted(trials, 'trial')}{of}, {minutes:.1f} min, "
        f"{report.channels} channels; {FORMATS.get(report.layout, 'a public set')}",
        f"held out by {report.held_out_by}: {counted(report.groups, report.held_out_by)}",
    ]
    lines += report.not_held_out
    if report.intents:
        lines.append(f"the wearer's command beside {counted(report.intents, 'trial')}")
    return lines


def _row(cell: Cell) -> tuple[str, ...]:
    """A cell as texts, one for each of HEADS; what is not known is "-"."""
    unread = cell.trials - cell.read

    mass = "-"
    if cell.mass_g is not None:
        mass = f"{cell.mass_g:g} ({Path(cell.mass_from or '').name})"

    labels = ", ".join(cell.labels_by)
    if len(cell.labels_by) > 1:
        labels = ", ".join(f"{name}: {n}" for name, n in cell.labels_by.items())
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


def _class_rows(classes: Sequence[ClassSeconds]) -> list[tuple[str, ...]]:
    """Situations and their seconds as texts; a column in which nothing is known is left out."""
    rows: list[tuple[str, ...]] = [CLASS_HEADS]
    for row in classes:
        seconds = row.light_s, row.heavy_s, row.unweighed_s
        rows.append((row.situation, *(f"{one:.1f}" for one in seconds)))
    if not any(row.unweighed_s for row in classes):
        return [row[:3] for row in rows]
    if not any(row.light_s + row.heavy_s for row in classes):
        return [(row[0], row[3]) for row in rows]
    return rows


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of texts as lines, each column as wide as its widest text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = [f"{cell:<{n}}" for cell, n in zip(row, widths, strict=True)]
        lines.append("  ".join(cells).rstrip())
    return lines


def _verdict(report: FolderReport) -> str:
    """The last line of a report: what the folder is ready for."""
    if report.layout not in (None, *FORMATS):
        return "a public set, read as it is"
    if not report.readable:
        return "not ready: correct each ERROR, then run holdfast check again"
    if not report.trainable:
        return (
            "ready for holdfast evaluate; holdfast train needs what FOR TRAINING says"
        )
    return "ready for holdfast train and holdfast evaluate"
