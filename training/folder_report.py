"""What a folder of recordings holds: people, objects, actions, rates, masses, labels."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from typing import Literal

import numpy as np

from holdfast.edge_runtime.contract import SITUATIONS
from holdfast.edge_runtime.errors import DataError
from holdfast.edge_runtime.reading import Json
from holdfast.training.datasets.places import TrialPlace
from holdfast.training.objects import object_name
from holdfast.training.windows import TimedTrial

Level = Literal["error", "training", "advice"]
CellName = tuple[str | None, str | None, str | None]
"""Person, object, action."""
Found = tuple[CellName, TimedTrial | None]
"""The cell of a trial, and the trial if it could be read."""


@dataclass(frozen=True)
class Missing:
    """Something that is missing: where, and what to write there.

    level: an error keeps the folder from being read, or the trial; training: it can be evaluated
    on, but not trained on.
    """

    level: Level
    where: str
    what: str
    next_step: str

    @staticmethod
    def of(error: DataError) -> Missing:
        """A fault of reading."""
        return Missing("error", error.where, error.what, error.next_step)


@dataclass(frozen=True)
class Cell:
    """All trials of one person with one object and one action; None where there is none such.

    read: how many of the trials can be read; the rest of a cell is about these. mass_from: the file
    that gives the mass. labels_by: source of the labels -> trials.
    """

    person: str | None
    object_name: str | None
    action: str | None
    trials: int
    read: int
    seconds: float
    rate_hz: float | None
    unit: str | None
    mass_g: float | None
    mass_from: str | None
    labels_by: dict[str, int]


@dataclass(frozen=True)
class ClassSeconds:
    """How long a situation lasts in all trials, with light and with heavy objects, s."""

    situation: str
    light_s: float
    heavy_s: float


@dataclass(frozen=True)
class FolderReport:
    """What was found in a folder, and what is missing.

    layout: None where no reader recognises the folder. held_out_by: what training holds out.
    intents: trials with the wearer's own command beside them.
    """

    folder: str
    layout: str | None
    held_out_by: str | None
    groups: int
    channels: int | None
    cells: list[Cell]
    classes: list[ClassSeconds]
    missing: list[Missing]
    intents: int = 0

    @property
    def readable(self) -> bool:
        """Whether `evaluate` takes the folder as it is."""
        return all(one.level != "error" for one in self.missing)

    @property
    def trainable(self) -> bool:
        """Whether `train` takes the folder as it is."""
        return all(one.level == "advice" for one in self.missing)

    def to_json(self) -> Json:
        """As `holdfast check --json` prints it."""
        return {**asdict(self), "readable": self.readable, "trainable": self.trainable}


def cell_of(place: TrialPlace) -> CellName:
    """The cell that a trial's place names."""
    folder = place.object_folder
    return place.person, object_name(folder.name) if folder else None, place.action


def cells_of(found: Sequence[Found]) -> list[Cell]:
    """The trials by person, object and action, in order of first sight."""
    by_cell: dict[CellName, list[TimedTrial | None]] = {}
    for name, trial in found:
        by_cell.setdefault(name, []).append(trial)
    return [_cell(name, trials) for name, trials in by_cell.items()]


def _cell(name: CellName, trials: Sequence[TimedTrial | None]) -> Cell:
    read = [trial for trial in trials if trial]
    recordings = [trial.recording for trial in read]
    mass = next((trial.mass for trial in read if trial.mass), None)
    return Cell(
        *name,
        len(trials),
        len(read),
        seconds=sum(len(one.samples) / one.rate_hz for one in recordings),
        rate_hz=float(np.median([one.rate_hz for one in recordings])) if read else None,
        unit=recordings[0].unit if read else None,
        mass_g=mass.mass_g if mass else None,
        mass_from=mass.source if mass else None,
        labels_by=dict(Counter(trial.labels_by for trial in read)),
    )


def seconds_of_classes(trials: Sequence[TimedTrial]) -> list[ClassSeconds]:
    """How long each class lasts. The hand alone counts half as light, half as heavy."""
    total = np.zeros((len(SITUATIONS), 2))
    for trial in trials:
        for situation, seconds in _seconds(trial):
            weight = [0.5, 0.5] if trial.heavy is None else [not trial.heavy, trial.heavy]
            total[situation] += np.multiply(weight, seconds)
    return [
        ClassSeconds(name, *map(float, row)) for name, row in zip(SITUATIONS, total, strict=True)
    ]


def _seconds(trial: TimedTrial) -> Iterator[tuple[int, float]]:
    for phase in trial.phases:
        yield phase.situation, (phase.stop - phase.first) / trial.recording.rate_hz
