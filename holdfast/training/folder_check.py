"""Examine a folder of recordings: read every trial, go on after a fault, say what is missing.

What a folder of recordings lacks, and what to write or record where.

What a folder of recordings holds: people, objects, actions, rates, masses, labels.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Literal

import numpy as np

from holdfast.core.contract import LIGHT_BELOW_G, SITUATIONS, UNITS
from holdfast.core.errors import DataError
from holdfast.core.objects import object_name, read_json
from holdfast.core.reading import Json
from holdfast.core.trial_layout import (
    INTENT_SUFFIX,
    META,
    RISKY_ACTIONS,
    TACTILE,
    VOLUNTARY_ACTIONS,
    intent_path,
    truth_path,
)
from holdfast.edge_runtime.intent import read_intent
from holdfast.training.datasets import LAYOUTS, layout_of, load, reader_of
from holdfast.training.datasets.thesis import common_rate
from holdfast.training.datasets.trials import FOLDERS, TrialPlace, TrialReader, read_all
from holdfast.training.progress import Part, ignored
from holdfast.training.splits import grouped
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
            weight = (
                [0.5, 0.5] if trial.heavy is None else [not trial.heavy, trial.heavy]
            )
            total[situation] += np.multiply(weight, seconds)
    return [
        ClassSeconds(name, *map(float, row))
        for name, row in zip(SITUATIONS, total, strict=True)
    ]


def _seconds(trial: TimedTrial) -> Iterator[tuple[int, float]]:
    for phase in trial.phases:
        yield phase.situation, (phase.stop - phase.first) / trial.recording.rate_hz


SCRIPT = "script"
LAYOUT = "<person>/<object>/<action>/trial_1.csv"
SLIPS = {"safe_slip": VOLUNTARY_ACTIONS, "risky_slip": RISKY_ACTIONS}
PHASES = '{"phases": [{"t0_s": 2.1, "t1_s": 6.4, "label": "grasp"}, ..]}'
LIGHT, HEAVY = f"under {LIGHT_BELOW_G:g} g", f"of {LIGHT_BELOW_G:g} g or more"


def advice(
    root: Path,
    layout: str,
    trials: Sequence[TimedTrial],
    classes: Sequence[ClassSeconds],
    *,
    all_read: bool,
) -> list[Missing]:
    """What is missing beside the faults: unit, people, classes, actions of people, exact labels.

    all_read: else only the first two are known, since an unread trial may have the rest.
    """
    if not trials:
        return []
    bare = layout == "thesis"
    if not all_read:
        return [*(_unit(root) if bare else ()), *_people(root, trials)]
    return [
        *(_unit(root) if bare else ()),
        *_people(root, trials),
        *_classes(root, classes),
        *_actions_of_people(root, trials),
        *(_labels(root, trials) if bare else ()),
    ]


def not_read(root: Path, read: Sequence[Path]) -> list[Missing]:
    """CSV files that are at no trial's place; an error where no file is at one."""
    others = sorted(
        path
        for path in set(root.rglob("*.csv")) - set(read)
        if path.name != TACTILE and not path.name.endswith(INTENT_SUFFIX)
    )
    if read and not others:
        return []
    what = "no CSV file"
    if others:
        first = others[0].relative_to(root).as_posix()
        what = f"CSV files at no trial's place: {len(others)}, such as {first}"
    next_step = (
        f"a trial belongs at {root / LAYOUT}; an action is one of {', '.join(FOLDERS)}"
    )
    return [Missing("advice" if read else "error", str(root), what, next_step)]


def _unit(root: Path) -> Iterator[Missing]:
    if "unit" not in read_json(root / META):
        units = " or ".join(f'{{"unit": "{unit}"}}' for unit in UNITS)
        yield Missing(
            "advice", str(root / META), "no unit; N is assumed", f"write {units}"
        )


def _people(root: Path, trials: Sequence[TimedTrial]) -> Iterator[Missing]:
    people = {trial.recording.person for trial in trials} - {None}
    if len(people) < 2:
        named = f"one person, {people.pop()}" if people else "no people"
        what = (
            f"{named}: figures are held out by trial and do not apply to other people"
        )
        yield Missing(
            "advice", str(root), what, f"sort trials of several people into {LAYOUT}"
        )


def _classes(root: Path, classes: Sequence[ClassSeconds]) -> Iterator[Missing]:
    for one in classes:
        action = SLIPS[one.situation][0] if one.situation in SLIPS else "<action>"
        for seconds, weight in ((one.light_s, LIGHT), (one.heavy_s, HEAVY)):
            if not seconds:
                path = root / "<person>" / f"<object {weight}>" / action / "trial_1.csv"
                what = f"no {one.situation} with an object {weight}"
                yield Missing("training", str(root), what, f"record {path}")


def _actions_of_people(root: Path, trials: Sequence[TimedTrial]) -> Iterator[Missing]:
    situations: dict[str, set[str]] = {}
    for trial in trials:
        if trial.recording.person is not None:
            seen = situations.setdefault(trial.recording.person, set())
            seen.update(SITUATIONS[phase.situation] for phase in trial.phases)
    for person, seen in situations.items() if len(situations) > 1 else ():
        for slip in SLIPS:
            if slip not in seen:
                actions = " or ".join(SLIPS[slip])
                yield Missing(
                    "advice",
                    str(root / person),
                    f"no {slip} of {person}",
                    f"record a {actions}",
                )


def _labels(root: Path, trials: Sequence[TimedTrial]) -> Iterator[Missing]:
    scripted = [trial for trial in trials if trial.labels_by.startswith(SCRIPT)]
    if scripted:
        truth = truth_path(root / f"{scripted[0].recording.trial_id}.csv")
        share = f"{len(scripted)} of {len(trials)} trials"
        what = f"{share} have labels by the script, not measured ones"
        yield Missing(
            "advice", str(truth), what, f"where you know the times, write {PHASES}"
        )


OF_THE_SET = "labels of the set"


def examine(root: Path, part: Part = ignored) -> FolderReport:
    """What a folder holds, and what is missing. part: receives the share of it that is read.

    Raises a DataError only where not even the layout is recognised.
    """
    layout = layout_of(root)
    if layout is None:
        return FolderReport(str(root), None, None, 0, None, [], [], not_read(root, []))
    if layout not in LAYOUTS:
        return _public(root, layout, part)
    faults: list[DataError] = []
    readers = _readers(root, layout, faults)
    trials = read_all(readers, faults.append, part)
    found = [
        (cell_of(one.place), trial) for one, trial in zip(readers, trials, strict=True)
    ]
    return _report(root, layout, found, faults, [one.place.path for one in readers])


def _report(
    root: Path,
    layout: str,
    found: Sequence[Found],
    faults: list[DataError],
    paths: Sequence[Path],
) -> FolderReport:
    trials = [trial for _, trial in found if trial]
    if trials:
        common_rate([trial.recording for trial in trials], faults.append)
    recordings, kind = grouped([trial.recording for trial in trials])
    classes = seconds_of_classes(trials)
    wrong = list(dict.fromkeys(Missing.of(fault) for fault in faults))
    intents, damaged = intents_beside(paths)
    others = not_read(root, paths) if paths else []
    return FolderReport(
        str(root),
        layout,
        kind if trials else None,
        len({one.group for one in recordings}),
        3 * recordings[0].n_sensors if recordings else None,
        cells_of(found),
        classes,
        [
            *wrong,
            *advice(root, layout, trials, classes, all_read=not wrong),
            *damaged,
            *others,
        ],
        intents,
    )


def intents_beside(trials: Sequence[Path]) -> tuple[int, list[Missing]]:
    """How many trials have the wearer's own command beside them; advice on those that are damaged.

    Training does not read these files.
    """
    paths = [path for path in map(intent_path, trials) if path.is_file()]
    damaged = []
    for path in paths:
        try:
            read_intent(path)
        except DataError as error:
            damaged.append(Missing("advice", error.where, error.what, error.next_step))
    return len(paths) - len(damaged), damaged


def _readers(root: Path, layout: str, faults: list[DataError]) -> list[TrialReader]:
    try:
        readers: list[TrialReader] = reader_of(layout).readers(root, faults.append)
    except DataError as error:
        faults.append(error)
        return []
    return readers


def _public(root: Path, layout: str, part: Part) -> FolderReport:
    """A public set: its reader refuses what is wrong, and it lacks nothing."""
    data = load(root, part=part)
    found = [
        (
            (one.person, one.object_name, one.action),
            TimedTrial(one, (), None, labels_by=OF_THE_SET),
        )
        for one in data.recordings
    ]
    n_groups, channels = len(data.groups()), 3 * data.n_sensors
    cells = cells_of(found)
    return FolderReport(
        str(root), layout, data.group_kind, n_groups, channels, cells, [], []
    )
