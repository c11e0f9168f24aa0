"""What a set holds, and how its situations are recognised, as short text tables.

Warnings of a set that holds too little to learn from or to judge a model on.
"""

from __future__ import annotations

import warnings

import numpy as np

from holdfast.core.reading import Json
from holdfast.training.figures import ABSENT, Interval, SituationFigures, over
from holdfast.training.recording import DataSet
from holdfast.training.splits import PLURAL


def windows_table(data: DataSet) -> str:
    """Windows by class, one block a task; sets in the thesis' layout show object x action too."""
    if "table" in data.notes:
        return "\n\n".join([data.notes["table"], _on_counts(data.notes)])
    lines = []
    for task, rows in data.tasks.items():
        counts = np.bincount(rows.label, minlength=len(rows.classes))
        cells = ", ".join(
            f"{name} {count:,}"
            for name, count in zip(rows.classes, counts, strict=True)
        )
        lines.append(f"{task}: {len(rows):,} windows ({cells})")
    return "\n".join(lines)


def _on_counts(notes: Json) -> str:
    """What the thesis' set was drawn from; of the others, that counts are no weights."""
    counts = notes.get("windows_natural") or notes["windows"]
    if counts == notes["windows"]:
        return "in training every class weighs the same, whatever its count"
    natural = ", ".join(f"{name} {count}" for name, count in counts.items())
    return f"all windows before undersampling: {natural}"


def situation_lines(of: SituationFigures, group_kind: str) -> list[str]:
    """The macro F1 and what it is over, then the F1 of each situation.

    group_kind: what the intervals resample.
    """
    macro = with_interval(of.macro_f1, of.macro_f1_ci, group_kind)
    return [
        f"macro F1 {over(of.f1) or 'over four situations'}  {macro}",
        *(
            f"  F1 {name:<12} {with_interval(f1, of.f1_ci[name], group_kind)}"
            for name, f1 in of.f1.items()
        ),
    ]


def with_interval(
    value: float | None, interval: Interval | None, group_kind: str
) -> str:
    """A figure and its interval over groups of a kind; "-" where it is not defined."""
    if value is None:
        return ABSENT
    if not interval:
        return f"{value:.3f}"
    groups, (low, high) = PLURAL.get(group_kind, "groups"), interval
    return f"{value:.3f}  (95 % interval over {groups} {low:.3f} to {high:.3f})"


FEWEST_WINDOWS = 50
"""Of a class; below, a forest learns single trials and an F1 jumps with each window."""


class FewWindows(UserWarning):
    """A class with fewer windows than FEWEST_WINDOWS."""


class FewGroups(UserWarning):
    """A set of two groups (people, objects, blocks, trials) only."""


def warn_of_scarcity(data: DataSet, *, undersampled: bool = False) -> None:
    """Warn (FewWindows, FewGroups) of a set that holds too little, and say what to do.

    undersampled: its windows are the thesis' set, which is as small as its rarest class.
    """
    few = ", ".join(_scarce_classes(data))
    if few:
        remedy = "leave out --windows thesis, or " if undersampled else ""
        warnings.warn(
            f"{data.name}: fewer than {FEWEST_WINDOWS} windows of {few}; do not trust the answers "
            f"and figures of these; next: {remedy}record or simulate more trials with them",
            FewWindows,
            stacklevel=2,
        )
    groups = {group for task in data.tasks for group in data.group_of(task)}
    if len(groups) == 2:
        kind = PLURAL.get(data.group_kind, "groups")
        remedy = (
            "raise --groups" if "kept_groups" in data.notes else f"record more {kind}"
        )
        warnings.warn(
            f"{data.name}: two {kind} only; each is answered by a model of the other alone, and "
            f"intervals mean little; next: {remedy}",
            FewGroups,
            stacklevel=2,
        )


def _scarce_classes(data: DataSet) -> list[str]:
    """Each scarce class with its count; a class without a window is an error of its own."""
    return [
        f"{name} ({count})"
        for rows in data.tasks.values()
        for name, count in zip(
            rows.classes,
            np.bincount(rows.label, minlength=len(rows.classes)),
            strict=True,
        )
        if 0 < count < FEWEST_WINDOWS
    ]
