"""Trials that are found but not yet read, so that a check can go on after a fault."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from holdfast.edge_runtime.errors import DataError
from holdfast.training.datasets.places import Fault, TrialPlace, refuse
from holdfast.training.say import Part, ignored
from holdfast.training.windows import TimedTrial


@dataclass(frozen=True)
class TrialReader:
    """A trial's place, and the function that reads, prepares and labels it."""

    place: TrialPlace
    read: Callable[[], TimedTrial]


def read_all(
    readers: Sequence[TrialReader], fault: Fault = refuse, part: Part = ignored
) -> list[TimedTrial | None]:
    """The trials in their order, None for one that cannot be used.

    fault: receives its DataError. part: receives the share of the trials that is read.
    """
    trials = []
    for number, reader in enumerate(readers, 1):
        trials.append(_read(reader, fault))
        part(number / len(readers))
    return trials


def _read(reader: TrialReader, fault: Fault) -> TimedTrial | None:
    try:
        return reader.read()
    except DataError as error:
        fault(error)
        return None
