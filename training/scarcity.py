"""Warnings of a set that holds too little to learn from or to judge a model on."""

from __future__ import annotations

import warnings

import numpy as np

from holdfast.training.hold_out import PLURAL
from holdfast.training.recording import DataSet

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
        remedy = "raise --groups" if "kept_groups" in data.notes else f"record more {kind}"
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
            rows.classes, np.bincount(rows.label, minlength=len(rows.classes)), strict=True
        )
        if 0 < count < FEWEST_WINDOWS
    ]
