"""What a folder of recordings holds and what is missing, for `holdfast check`.

Every trial is read; a fault is noted and the reading goes on. What is missing is told with what to
write or record, and where.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from holdfast.core.contract import (
    CLASSES,
    SITUATIONS,
    Json,
)
from holdfast.core.errors import ColumnError, DataError, NotANumber, RateError
from holdfast.core.trial_file import implausible_rate
from holdfast.core.trial_layout import (
    INTENT_SUFFIX,
    TACTILE,
    has_logs,
    import_command,
    intent_path,
    object_name,
)
from holdfast.edge_runtime.wearer import read_intent
from holdfast.training.datasets import LAYOUTS, layout_of, load, reader_of
from holdfast.training.datasets.thesis import common_rate, of_trials
from holdfast.training.datasets.trials import FOLDERS, TrialReader, read_all
from holdfast.training.folder_advice import (
    LAYOUT,
    ClassSeconds,
    Level,
    Missing,
    advice_on,
)
from holdfast.training.judging import HoldOutChoice, strictest_hold_out
from holdfast.training.plan import TrainingPlan
from holdfast.training.progress import Part, ignored
from holdfast.training.windows import TimedTrial, classes_of

TRAINING_SEED = 0
"""Of `holdfast train` where none is given."""
OF_THE_SET = "labels of the set"
"""What the labels of a public set come from."""
CellName = tuple[str | None, str | None, str | None]
"""Person, object, action."""
CellTrials = dict[CellName, list[TimedTrial | None]]
"""The trials of each cell in order of first sight; None for one that cannot be read."""


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
class FolderReport:
    """What was found in a folder, and what is missing.

    layout: None where no reader recognises the folder. held_out_by: what training holds out.
    groups: how many of these there are. channels: of the first recording, three a sensor.
    intents: trials with a file of the wearer's command. not_held_out: why not by something
    stricter, a line each.
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
    not_held_out: list[str] = field(default_factory=list)

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


def examine(root: Path, part: Part = ignored) -> FolderReport:
    """What a folder holds, and what is missing. part: receives the share of it that is read.

    Raises a DataError only where not even the layout is recognised.
    """
    layout = layout_of(root)
    if layout is None:
        return FolderReport(str(root), None, None, 0, None, [], [], _not_read(root, []))
    if layout not in LAYOUTS:
        return _public(root, layout, part)

    # Faults are collected, so that one run names all of them.
    faults: list[DataError] = []
    readers: list[TrialReader] = []
    try:
        readers = reader_of(layout).readers(root, faults.append)
    except DataError as error:
        faults.append(error)

    cells: CellTrials = {}
    trials = []
    for name, trial in _read(readers, faults, part):
        cells.setdefault(name, []).append(trial)
        if trial:
            trials.append(trial)

    # Checks of the whole set compare only what can be read: a fault of one trial is noted already.
    if trials:
        common_rate([trial.recording for trial in trials], faults.append)
    held_out = _held_out(trials, root, faults)
    classes = _class_seconds(trials)
    # The same fault of a file may be met twice; the keys of a dict keep the first, in order.
    missing = list(dict.fromkeys(Missing.of(fault) for fault in faults))
    if not trials and any(
        isinstance(fault, ColumnError | NotANumber) for fault in faults
    ):
        what = "no trial has the columns of the layout: logs of another program?"
        missing.append(Missing("error", str(root), what, import_command(root)))
    if held_out:
        kind, all_read = held_out.kind, not missing
        missing += advice_on(root, layout, trials, classes, kind, all_read=all_read)

    # Training reads no file of the wearer's command, so a damaged one is advice and no error.
    paths = [reader.place.path for reader in readers]
    intents, damaged = _intents(paths)
    missing += damaged
    if paths:
        missing += _not_read(root, paths)

    return FolderReport(
        folder=str(root),
        layout=layout,
        held_out_by=held_out.kind if held_out else None,
        groups=len(held_out.data.groups()) if held_out else 0,
        channels=3 * trials[0].recording.n_sensors if trials else None,
        cells=_cells(cells),
        classes=classes,
        missing=missing,
        intents=intents,
        not_held_out=held_out.lines() if held_out else [],
    )


def _public(root: Path, layout: str, part: Part) -> FolderReport:
    """A public set: its reader refuses what is wrong, and it lacks nothing."""
    data = load(root, part=part)
    cells: CellTrials = {}
    for recording in data.recordings:
        name = (recording.person, recording.object_name, recording.action)
        trial = TimedTrial(recording, None, labels_by=OF_THE_SET)
        cells.setdefault(name, []).append(trial)
    held_out = strictest_hold_out(data, TrainingPlan.folds, TRAINING_SEED)
    return FolderReport(
        folder=str(root),
        layout=layout,
        held_out_by=held_out.kind,
        groups=len(held_out.data.groups()),
        channels=3 * data.n_sensors,
        cells=_cells(cells),
        classes=[],
        missing=[],
        not_held_out=held_out.lines(),
    )


def _read(
    readers: Sequence[TrialReader], faults: list[DataError], part: Part
) -> Iterator[tuple[CellName, TimedTrial | None]]:
    """Every trial with the name of its cell; None for one that cannot be read."""
    read = read_all(readers, faults.append, part)
    for reader, trial in zip(readers, read, strict=True):
        place = reader.place
        folder = place.object_folder
        name = object_name(folder.name) if folder else None
        yield (place.person, name, place.action), trial


def _held_out(
    trials: list[TimedTrial], root: Path, faults: list[DataError]
) -> HoldOutChoice | None:
    """What `train` holds out of these trials where it is asked for nothing else.

    None, with a fault, where their rate is too low for training.
    """
    if not trials:
        return None
    # Neither names nor rates change what is held out; with faults the trials may differ in both.
    about = {"name": "", "kind": ""}
    rate_hz = trials[0].recording.rate_hz
    try:
        data = of_trials(trials, about, rate_hz, "balanced", TRAINING_SEED)
    except RateError as error:
        # a rate that is not one at all is named by trial already
        if not implausible_rate(rate_hz):
            faults.append(
                RateError(
                    error.what, where=root, cause=error.cause, next_step=error.next_step
                )
            )
        return None
    return strictest_hold_out(data, TrainingPlan.folds, TRAINING_SEED)


def _cells(cells: CellTrials) -> list[Cell]:
    """The cells of a report, in the order in which the folder has them."""
    return [_cell(name, trials) for name, trials in cells.items()]


def _cell(name: CellName, trials: list[TimedTrial | None]) -> Cell:
    """The figures of a cell; its unit and its mass are those of its first trial."""
    person, known_name, action = name
    seconds = 0.0
    rates_hz = []
    unit = None
    mass = None
    labels_by: Counter[str] = Counter()
    for trial in trials:
        if trial is None:
            continue
        recording = trial.recording
        seconds += len(recording.samples) / recording.rate_hz
        rates_hz.append(recording.rate_hz)
        labels_by[trial.labels_by] += 1
        unit = unit or recording.unit
        mass = mass or trial.mass

    return Cell(
        person=person,
        object_name=known_name,
        action=action,
        trials=len(trials),
        read=len(rates_hz),
        seconds=seconds,
        rate_hz=float(np.median(rates_hz)) if rates_hz else None,
        unit=unit,
        mass_g=mass.mass_g if mass else None,
        mass_from=mass.source if mass else None,
        labels_by=dict(labels_by),
    )


def _class_seconds(trials: Sequence[TimedTrial]) -> list[ClassSeconds]:
    """How long each class lasts.

    The hand alone counts half as light, half as heavy, where the weight is learned.
    """
    light_s = [0.0] * len(SITUATIONS)
    heavy_s = [0.0] * len(SITUATIONS)
    unweighed_s = [0.0] * len(SITUATIONS)
    weighed = classes_of(trials) == CLASSES
    for trial in trials:
        # Without an object the hand is as light as it is heavy.
        heavy = 0.5 if trial.heavy is None else float(trial.heavy)
        known = trial.heavy is not None or (weighed and not trial.has_object)
        for phase in trial.recording.phases:
            seconds = (phase.stop - phase.first) / trial.recording.rate_hz
            if not known:
                unweighed_s[phase.situation] += seconds
                continue
            light_s[phase.situation] += (1.0 - heavy) * seconds
            heavy_s[phase.situation] += heavy * seconds

    classes = []
    for number, situation in enumerate(SITUATIONS):
        of_number = light_s[number], heavy_s[number], unweighed_s[number]
        classes.append(ClassSeconds(situation, *of_number))
    return classes


def _not_read(root: Path, read: Sequence[Path]) -> list[Missing]:
    """CSV files that are at no trial's place; an error where no file is at one."""
    others = []
    for path in sorted(set(root.rglob("*.csv")) - set(read)):
        if path.name != TACTILE and not path.name.endswith(INTENT_SUFFIX):
            others.append(path)
    if read and not others:
        return []

    what = "no trial" if has_logs(root) else "no CSV file"
    if others:
        first = others[0].relative_to(root).as_posix()
        what = f"CSV files at no trial's place: {len(others)}, such as {first}"

    actions = ", ".join(FOLDERS)
    next_step = f"a trial belongs at {root / LAYOUT}; an action is one of {actions}"
    if not read and has_logs(root):
        next_step += f"; logs of another program: {import_command(root)}"
    level: Level = "advice" if read else "error"
    return [Missing(level, str(root), what, next_step)]


def _intents(trials: Sequence[Path]) -> tuple[int, list[Missing]]:
    """How many trials have a file of the wearer's command; advice on those that are damaged.

    Training does not read these files.
    """
    whole = 0
    damaged = []
    for path in map(intent_path, trials):
        if path.is_file():
            try:
                read_intent(path)
                whole += 1
            except DataError as error:
                damaged.append(Missing.of(error, "advice"))
    return whole, damaged
