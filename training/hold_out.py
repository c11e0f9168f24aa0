"""What is held out together: all trials of a person, of an object, or one trial at a time.

A group is never on both sides of a split, and intervals resample groups.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Literal

from holdfast.edge_runtime.errors import TooFewGroups
from holdfast.training.recording import DataSet, Recording

HoldOut = Literal["person", "object", "trial"]
NO_OBJECT = "-"
PLURAL = {"person": "people", "object": "objects", "trial": "trials", "block": "blocks"}


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


def in_words(n_groups: int, kind: str) -> str:
    """How many groups there are, and of what.

    >>> in_words(3, "person"), in_words(1, "object"), in_words(4, "trial")
    ('3 people', '1 object', '4 trials')
    """
    return f"{n_groups} {kind if n_groups == 1 else PLURAL[kind]}"
