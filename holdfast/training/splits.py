"""Training and test sets: a person (or block) is never in both.

What is held out together: all trials of a person, of an object, or one trial at a time.

A group is never on both sides of a split, and intervals resample groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

import numpy as np
import numpy.typing as npt

from holdfast.core.errors import TooFewGroups
from holdfast.training.recording import DataSet, Recording

Rows = npt.NDArray[np.int64]
Fold = tuple[Rows, Rows]
"""Training rows and test rows, both ascending."""


def assign_groups(
    groups: npt.ArrayLike, n_folds: int, *, seed: int = 0
) -> dict[str, int]:
    """Fold of every group, from the group names [M] of all windows.

    Groups are dealt largest first, one to each fold a round, in seeded random order within a round:
    folds get equally many groups (+-1), and their windows differ by at most the largest group's.
    Raises TooFewGroups where there are fewer groups than folds, or fewer than two folds.

    >>> sorted(assign_groups(["a", "a", "b", "c", "d"], 2).values())
    [0, 0, 1, 1]
    """
    names, sizes = np.unique(np.asarray(groups, dtype=str), return_counts=True)
    if n_folds < 2 or len(names) < n_folds:
        raise TooFewGroups(
            f"{len(names)} groups (people, blocks) do not make {n_folds} folds",
            cause="the set holds too few people, or was cut down with --groups",
            next_step=f"use {len(names)} folds"
            if len(names) > 1
            else "add recordings of other people",
        )
    rng = np.random.default_rng(seed)
    by_size = names[np.argsort(-sizes, kind="stable")]
    assignment: dict[str, int] = {}
    for k in range(0, len(names), n_folds):
        dealt = by_size[k : k + n_folds].tolist()
        assignment.update(zip(dealt, rng.permutation(n_folds).tolist(), strict=False))
    return assignment


def grouped_folds(groups: npt.ArrayLike, n_folds: int, *, seed: int = 0) -> list[Fold]:
    """Cross-validation by groups [M]. Raises TooFewGroups.

    For two tasks with the same held-out people, call `assign_groups` once and `folds_of` for each
    task.
    """
    return folds_of(groups, assign_groups(groups, n_folds, seed=seed))


def folds_of(groups: npt.ArrayLike, assignment: dict[str, int]) -> list[Fold]:
    """Training and test rows of every fold, for windows of these groups [M]."""
    fold = np.array(
        [assignment[str(name)] for name in np.asarray(groups, dtype=str)],
        dtype=np.int64,
    )
    return [
        (np.flatnonzero(fold != k), np.flatnonzero(fold == k))
        for k in sorted(set(assignment.values()))
    ]


def leaky_folds(n_rows: int, n_folds: int, *, seed: int = 0) -> list[Fold]:
    """Folds of random windows, so that neighbours in time are on both sides.

    WRONG, and named so: it exists to show, beside the right number, how far a bad split flatters.
    """
    fold = np.random.default_rng(seed).permutation(n_rows) % n_folds
    return [
        (np.flatnonzero(fold != k), np.flatnonzero(fold == k)) for k in range(n_folds)
    ]


HoldOut = Literal["person", "object", "trial"]
NO_OBJECT = "-"


def grouped(recordings: Sequence[Recording]) -> tuple[list[Recording], HoldOut]:
    """The recordings with their groups, and the kind of these.

    People are the groups where there are two or more; else every trial is one.
    """
    people = {one.person for one in recordings if one.person is not None}
    kind: HoldOut = "person" if len(people) > 1 else "trial"
    return [replace(one, group=_group(one, kind)) for one in recordings], kind


def regrouped(data: DataSet, by: HoldOut) -> DataSet:
    """The same set held out by something else. Raises TooFewGroups with less than two groups."""
    recordings = [replace(one, group=_group(one, by)) for one in data.recordings]
    count = len({one.group for one in recordings})
    if count < 2 or (by == "person" and any(one.person is None for one in recordings)):
        raise TooFewGroups(
            f"the recordings cannot be held out by {by}",
            where=data.name,
            cause="the set names no people" if by == "person" else f"one {by} alone",
            next_step=_NEXT[by],
        )
    return replace(data, recordings=recordings, group_kind=by)


_NEXT = {
    "person": "sort trials into <person>/<object>/<action>/, or hold out by trial",
    "object": "record another object, or hold out by trial",
    "trial": "record more trials",
}


def _group(recording: Recording, by: HoldOut) -> str:
    names = {
        "person": recording.person,
        "object": recording.object_name or NO_OBJECT,
        "trial": recording.trial_id,
    }
    return names[by] or recording.trial_id
