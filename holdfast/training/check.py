"""What a folder of recordings holds and what is missing, for `holdfast check`.

Every trial is read; a fault is noted and the reading goes on. Each thing that is missing comes with
what to write or record, and where. A model learns whatever situations and masses there are.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path

import numpy as np

from holdfast.core.contract import CLASSES, NOTHING, SITUATIONS, UNITS, Json
from holdfast.core.errors import (
    ColumnError,
    DataError,
    NotANumber,
    count_of,
)
from holdfast.core.hand_card import HandCard, hand_or_usual
from holdfast.core.trial_layout import (
    HAND_FILE,
    META,
    TACTILE,
    has_logs,
    import_command,
    object_name,
    read_json,
    truth_path,
    weigh_it,
)
from holdfast.training.datasets import (
    LAYOUTS,
    layout_of,
    load,
    reader_of,
    thesis,
    with_hand,
)
from holdfast.training.datasets.trials import (
    FOLDERS,
    Missing,
    TrialReader,
    doubts_of,
    read_all,
)
from holdfast.training.judging import strictest_hold_out
from holdfast.training.plan import TrainingPlan
from holdfast.training.recording import DataSet, lost_spans
from holdfast.training.windows import TimedTrial, classes_of

LAYOUT = "<person>/<object>/<action>/trial_1.csv"
PHASES = '{"phases": [{"t0_s": 2.1, "t1_s": 6.4, "label": "grasp"}, ..]}'
"""An example of a truth file, for the advice."""
RECORD = {
    "nothing": "<person>/nothing",
    "grasp": "<person>/<object>/hold",
    "safe_slip": "<person>/<object>/pass",
    "risky_slip": "<person>/<object>/slip",
}
"""Where a trial of each situation belongs, as it is advised."""
NO_WEIGHT = "a model does not learn light and heavy"
CellName = tuple[str | None, str | None, str | None]
"""Person, object, action."""
Cells = dict[CellName, list[TimedTrial | None]]
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
class ClassSeconds:
    """How long a situation lasts in all trials: with light, heavy and unweighed objects, s."""

    situation: str
    light_s: float
    heavy_s: float
    unweighed_s: float


@dataclass
class FolderReport:
    """What was found in a folder, and what is missing.

    layout: None where no reader recognises the folder. held_out_by: what training holds out.
    groups: how many of these there are. channels: of the first recording, three a sensor.
    not_held_out: why not by something stricter, a line each.
    """

    folder: str
    layout: str | None
    held_out_by: str | None = None
    groups: int = 0
    channels: int | None = None
    cells: list[Cell] = field(default_factory=list)
    classes: list[ClassSeconds] = field(default_factory=list)
    missing: list[Missing] = field(default_factory=list)
    not_held_out: list[str] = field(default_factory=list)

    @property
    def readable(self) -> bool:
        """Whether `evaluate` takes the folder as it is."""
        return all(one.level != "error" for one in self.missing)

    @property
    def trainable(self) -> bool:
        """Whether `train` takes the folder as it is."""
        return all(one.level in ("advice", "doubt") for one in self.missing)

    @property
    def doubtful(self) -> bool:
        """Whether figures of the folder are probably wrong."""
        return any(one.level == "doubt" for one in self.missing)

    def to_json(self) -> Json:
        """As `holdfast check --json` prints it."""
        return {**asdict(self), "readable": self.readable, "trainable": self.trainable}


def examine(root: Path, most_n: float | None = None) -> FolderReport:
    """What a folder holds, and what is missing or doubtful.

    most_n: the largest grip of the hand, N of either side, where it is given.
    """
    layout = layout_of(root)
    report = FolderReport(str(root), layout)
    if layout is None:
        report.missing = _not_read(root, [])
    elif layout in LAYOUTS:
        _examine_trials(report, root, layout, most_n)
    else:
        # The reader of a public set refuses what is wrong, and the set lacks nothing.
        data = load(root)
        cells: Cells = {}
        for one in data.recordings:
            name = (one.person, one.object_name, one.action)
            trial = TimedTrial(one, None, labels_by="labels of the set")
            cells.setdefault(name, []).append(trial)
        report.cells = [_cell(name, of_cell) for name, of_cell in cells.items()]
        _hold_out(report, data)
    return report


def _examine_trials(
    report: FolderReport, root: Path, layout: str, most_n: float | None
) -> None:
    """Read all trials of a folder of these, and fill in the report."""
    # Faults are collected, so that one run names all of them.
    faults: list[DataError] = []
    readers: list[TrialReader] = []
    try:
        readers = reader_of(layout).readers(root, faults.append)
    except DataError as error:
        faults.append(error)
    read = read_all(readers, faults.append)
    trials = [trial for trial in read if trial]
    doubts: list[Missing] = []
    cells: Cells = {}
    for reader, trial in zip(readers, read, strict=True):
        cells.setdefault(_cell_of(reader), []).append(trial)
    report.cells = [_cell(name, of_cell) for name, of_cell in cells.items()]
    report.classes = _class_seconds(trials)

    # Checks of the whole set compare only what can be read: a fault of one trial is noted already.
    if trials:
        thesis.common_rate([trial.recording for trial in trials], faults.append)
        rate_hz = trials[0].recording.rate_hz
        # Neither names nor rates change what is held out.
        about = thesis.SetMeta()
        try:
            data = thesis.of_trials(trials, about, rate_hz, "balanced", seed=0)
            _hold_out(report, data)
            hand = with_hand(data, root).hand
            doubts += _sides_unknown(root, data.n_sensors, hand)
        except DataError as error:
            faults.append(error)
        doubts += doubts_of(trials, most_n)

    missing = []
    for fault in faults:
        where = fault.where or str(root)
        missing.append(Missing("error", where, fault.what, fault.next_step))
    if not trials and any(isinstance(one, ColumnError | NotANumber) for one in faults):
        what = "no trial has the columns of the layout: logs of another program?"
        missing.append(Missing("error", str(root), what, import_command(root)))
    missing += doubts
    if trials:
        # What seems to be missing may be in a trial that could not be read.
        missing += _advice(report, root, trials, all_read=not faults)
    if readers:
        missing += _not_read(root, [reader.place.path for reader in readers])
    # The same fault of a file may be met twice; the keys of a dict keep the first, in order.
    report.missing = list(dict.fromkeys(missing))


def _hold_out(report: FolderReport, data: DataSet) -> None:
    """What `train` holds out of a set where it is asked for nothing else."""
    report.channels = 3 * data.n_sensors
    held_out = strictest_hold_out(data, TrainingPlan.folds, seed=0)
    report.held_out_by = held_out.kind
    report.groups = len(held_out.data.groups())
    report.not_held_out = held_out.lines()


def _not_read(root: Path, read: Sequence[Path]) -> list[Missing]:
    """CSV files that are at no trial's place; an error where no file is at one."""
    left = sorted(set(root.rglob("*.csv")) - set(read))
    others = [path for path in left if not _is_of_a_trial(path)]
    what = "no trial" if has_logs(root) else "no CSV file"
    if others:
        first = others[0].relative_to(root).as_posix()
        what = f"CSV files at no trial's place: {len(others)}, such as {first}"
    elif read:
        return []

    step = (
        f"a trial belongs at {root / LAYOUT}; an action is one of {', '.join(FOLDERS)}"
    )
    if read:
        return [Missing("advice", str(root), what, step)]
    if has_logs(root):
        step += f"; logs of another program: {import_command(root)}"
    return [Missing("error", str(root), what, step)]


def _is_of_a_trial(path: Path) -> bool:
    """Whether a file lies in a trial's folder, or beside its trial as trial_1.motion.csv does."""
    trial = path.with_name(f"{path.name.partition('.')[0]}.csv")
    if trial != path and trial.is_file():
        return True
    return any((folder / TACTILE).is_file() for folder in path.parents)


def _sides_unknown(
    root: Path, n_sensors: int, hand: HandCard | None
) -> Iterator[Missing]:
    """Where no card says on which side the sensors are."""
    if hand_or_usual(hand, n_sensors) is None:
        what = f"{count_of(n_sensors, 'sensor')} and no hand card: pooled features take each to be "
        what += "on the side of the fingers"
        step = "write which are on the thumb's side (docs/scenes.md, hands)"
        yield Missing("doubt", str(root / HAND_FILE), what, step)


# -- the two tables


def _cell_of(reader: TrialReader) -> CellName:
    """The cell that the folders of a trial name."""
    place = reader.place
    folder = place.object_folder
    return place.person, object_name(folder.name) if folder else None, place.action


def _cell(name: CellName, trials: list[TimedTrial | None]) -> Cell:
    """The figures of a cell; its unit and its mass are those of its first trial."""
    read = [trial for trial in trials if trial]
    recordings = [trial.recording for trial in read]
    rates_hz = [one.rate_hz for one in recordings]
    mass = next((trial.mass for trial in read if trial.mass), None)
    return Cell(
        *name,
        trials=len(trials),
        read=len(read),
        seconds=sum(len(one.samples) / one.rate_hz for one in recordings),
        rate_hz=float(np.median(rates_hz)) if rates_hz else None,
        unit=recordings[0].unit if recordings else None,
        mass_g=mass.mass_g if mass else None,
        mass_from=mass.source if mass else None,
        labels_by=dict(Counter(trial.labels_by for trial in read)),
    )


def _class_seconds(trials: Sequence[TimedTrial]) -> list[ClassSeconds]:
    """How long each situation lasts.

    The hand alone counts half as light, half as heavy, where the weight is learned.
    """
    weighed = classes_of(trials) == CLASSES
    # rows: situations; columns: light, heavy, mass unknown
    seconds = np.zeros((len(SITUATIONS), 3))
    shares = {False: [1.0, 0.0, 0.0], True: [0.0, 1.0, 0.0], None: [0.0, 0.0, 1.0]}
    for trial in trials:
        share = shares[trial.heavy]
        if trial.heavy is None and weighed and not trial.has_object:
            share = [0.5, 0.5, 0.0]
        for phase in trial.recording.phases:
            lasts_s = (phase.stop - phase.first) / trial.recording.rate_hz
            seconds[phase.situation] += lasts_s * np.array(share)

    rows = zip(SITUATIONS, seconds.tolist(), strict=True)
    return [ClassSeconds(situation, *of_weight) for situation, of_weight in rows]


# -- what more data would bring


def _advice(
    report: FolderReport, root: Path, trials: Sequence[TimedTrial], *, all_read: bool
) -> Iterator[Missing]:
    """Unit, people, masses, situations, weights, labels; all_read: else only the first three."""
    # The recorder writes unit and labels itself; only folders made by hand can lack them.
    bare = report.layout == "thesis"
    if bare and "unit" not in read_json(root / META):
        units = " or ".join(f'{{"unit": "{unit}"}}' for unit in UNITS)
        where = str(root / META)
        yield Missing("advice", where, "no unit; N is assumed", f"write {units}")

    people = {trial.recording.person for trial in trials} - {None}
    if len(people) < 2:
        named = f"one person, {people.pop()}" if people else "no people"
        held_out = f"figures are held out by {report.held_out_by}"
        what = f"{named}: {held_out} and do not apply to other people"
        step = f"sort trials of several people into {LAYOUT}"
        yield Missing("advice", str(root), what, step)

    for trial in trials:
        name = trial.recording.object_name
        if name is not None and trial.heavy is None:
            # The folder of the object is two above the file of the trial.
            folder = root / Path(trial.recording.trial_id).parent.parent
            what = f"no mass given for object {name!r}: {NO_WEIGHT}"
            yield Missing("advice", str(folder), what, weigh_it(folder))

    for trial in trials:
        recording = trial.recording
        lost = [stop - first for first, stop in lost_spans(recording.valid)]
        if lost:
            gaps = (
                f"{count_of(len(lost), 'gap')} of {sum(lost) / recording.rate_hz:.2f} s"
            )
            what = (
                f"{gaps} together, the longest of {max(lost) / recording.rate_hz:.2f} s"
            )
            step = "nothing: they are lost samples, and the answer is unknown over them"
            yield Missing("advice", recording.trial_id, what, step)

    if all_read:
        yield from _missing_situations(report.classes, root, trials)
    scripted = [one for one in trials if one.labels_by.startswith(thesis.BY_SCRIPT)]
    if all_read and bare and scripted:
        truth = truth_path(root / f"{scripted[0].recording.trial_id}.csv")
        share = f"{len(scripted)} of {len(trials)} trials"
        what = f"{share} have labels by the script, not measured ones"
        step = f"where you know the times, write {PHASES}"
        yield Missing("advice", str(truth), what, step)


def _missing_situations(
    classes: Sequence[ClassSeconds], root: Path, trials: Sequence[TimedTrial]
) -> Iterator[Missing]:
    """Situations without a sample, and those with light or with heavy objects alone."""
    # Where a mass is not known, no weight is learned whatever there is.
    weighed = classes_of(trials) == CLASSES
    in_n = trials[0].recording.unit == "N"
    lasting: list[float] = []
    for one in classes:
        lasting.append(one.light_s + one.heavy_s + one.unweighed_s)
    # Of one situation alone there is nothing to learn.
    alone = np.count_nonzero(lasting) < 2
    for one, lasts_s in zip(classes, lasting, strict=True):
        step = f"record {root / RECORD[one.situation]}/trial_1.csv"
        is_nothing = one.situation == SITUATIONS[NOTHING]
        # In N a model knows an empty hand by its force, and learns nothing of it.
        if not lasts_s and (alone or not (in_n and is_nothing)):
            what = f"no {one.situation}: a model cannot tell it"
            yield Missing("training" if alone else "advice", str(root), what, step)
        elif weighed and not is_nothing and not (one.light_s and one.heavy_s):
            lacks = "heavy" if one.light_s else "light"
            what = f"no {one.situation} with a {lacks} object: {NO_WEIGHT}"
            yield Missing("advice", str(root), what, step)
