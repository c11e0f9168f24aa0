"""What a folder of recordings holds and what is missing, for `holdfast check`: as data, as lines.

Every trial is read; a fault is noted and the reading goes on. Each thing that is missing comes with
what to write or record, and where. A model learns whatever situations and masses there are.
"""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass, field
from pathlib import Path
from types import ModuleType

import numpy as np

from holdfast.core.contract import NOTHING, SITUATIONS, UNITS, Json
from holdfast.core.errors import ColumnError, DataError, NotANumber, count_of
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
from holdfast.data.datasets import (
    LAYOUTS,
    layout_of,
    load,
    reader_of,
    thesis,
    with_hand,
)
from holdfast.data.datasets.trials import (
    FOLDERS,
    Missing,
    TrialReader,
    by_kind,
    doubts_of,
    sides_unknown,
    silent_axes,
)
from holdfast.data.lifts import NOISES
from holdfast.data.metrics import in_words
from holdfast.data.recording import DataSet, counts_in_words, lost_spans
from holdfast.data.windows import TimedTrial
from holdfast.training.judging import strictest_hold_out
from holdfast.training.plan import TrainingPlan

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
LEVELS = {
    "error": "ERROR",
    "doubt": "DOUBTFUL",
    "training": "FOR TRAINING",
    "advice": "ADVICE",
}
FORMATS = {"thesis": "folders of CSV trials", "recorded": "folders of holdfast record"}
"""Layouts in words; any other is a public set."""
HEADS = ("person", "object", "action", "trials", "mass, g", "labels by")
CellName = tuple[str | None, str | None, str | None]
"""Person, object, action."""
Found = list[tuple[CellName, TimedTrial | None]]
"""Trials with their cells; None for one that cannot be read."""


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
    mass_g: float | None
    mass_from: str | None
    labels_by: dict[str, int]


@dataclass
class FolderReport:
    """What was found in a folder, and what is missing.

    layout: None where no reader recognises the folder. held_out_by: what training holds out.
    groups: how many of these there are. channels: three a sensor. rate_hz, unit, channels: of the
    whole set. windows: those that `train` learns from, by class or situation. not_held_out: why not
    by something stricter, a line each. not_measured: channels, by the hand card.
    """

    folder: str
    layout: str | None
    held_out_by: str | None = None
    groups: int = 0
    channels: int | None = None
    rate_hz: float | None = None
    unit: str | None = None
    cells: list[Cell] = field(default_factory=list)
    windows: dict[str, int] = field(default_factory=dict)
    missing: list[Missing] = field(default_factory=list)
    not_held_out: list[str] = field(default_factory=list)
    not_measured: list[str] = field(default_factory=list)

    @property
    def levels(self) -> set[str]:
        """The levels of what is missing."""
        return {one.level for one in self.missing}

    @property
    def readable(self) -> bool:
        """Whether `evaluate` takes the folder as it is."""
        return "error" not in self.levels

    @property
    def trainable(self) -> bool:
        """Whether `train` takes the folder as it is."""
        return self.levels <= {"advice", "doubt"}

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
        _examine_trials(report, root, reader_of(layout), most_n)
    else:
        # The reader of a public set refuses what is wrong, and the set lacks nothing.
        data = load(root)
        found: Found = []
        for one in data.recordings:
            trial = TimedTrial(one, None, labels_by="labels of the set")
            found.append(((one.person, one.object_name, one.action), trial))
        report.cells = _cells(found)
        _describe(report, data)
    return report


def _examine_trials(
    report: FolderReport, root: Path, layout: ModuleType, most_n: float | None
) -> None:
    """Read all trials of a folder by the module of its layout, and fill in the report."""
    # Faults are collected, so that one run names all of them.
    faults: list[DataError] = []
    readers: list[TrialReader] = []
    try:
        readers = layout.readers(root, faults.append)
    except DataError as error:
        faults.append(error)
    found: Found = []
    for reader in readers:
        folder = reader.place.object_folder
        name = object_name(folder.name) if folder else None
        trial = None
        try:
            trial = reader.read()
        except DataError as error:
            faults.append(error)
        found.append(((reader.place.person, name, reader.place.action), trial))
    report.cells = _cells(found)
    trials = [trial for _, trial in found if trial]

    # Checks of the whole set compare only what can be read: a fault of one trial is noted already.
    doubts: list[Missing] = []
    if trials:
        try:
            doubts += _examine_set(report, root, trials, faults)
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


def _examine_set(
    report: FolderReport, root: Path, trials: list[TimedTrial], faults: list[DataError]
) -> Iterator[Missing]:
    """What is doubtful of all trials together; raises and appends the faults of the whole set."""
    rate_hz = thesis.common_rate([trial.recording for trial in trials], faults.append)
    data = thesis.of_trials(trials, thesis.SetMeta(), rate_hz, "balanced", seed=0)
    _describe(report, data)
    (report.windows,) = [rows.class_counts() for rows in data.tasks.values()]
    data = with_hand(data, root)
    if data.hand and data.hand.unmeasured_names:
        report.not_measured = list(data.hand.unmeasured_names)
    yield from sides_unknown(data, root)
    yield from silent_axes(data, root)


def _describe(report: FolderReport, data: DataSet) -> None:
    """Rate, unit and channels of a set, and what `train` holds out if nothing else is given."""
    report.channels = 3 * data.n_sensors
    report.rate_hz, report.unit = data.rate_hz, data.unit
    held_out = strictest_hold_out(data, TrainingPlan.folds, seed=0)
    report.held_out_by = held_out.kind
    report.groups = len(held_out.data.groups())
    report.not_held_out = held_out.lines()


def _not_read(root: Path, read: Sequence[Path]) -> list[Missing]:
    """CSV files that are at no trial's place; an error where no file is at one."""
    others = []
    for path in sorted(set(root.rglob("*.csv")) - set(read)):
        # Beside a trial stands trial_1.motion.csv, or what else is in the recorder's folder.
        if "." not in path.stem and not path.with_name(TACTILE).is_file():
            others.append(path.relative_to(root).as_posix())
    what = "no trial" if has_logs(root) else "no CSV file"
    if others:
        what = f"CSV files at no trial's place: {len(others)}, such as {others[0]}"
    elif read:
        return []

    step = (
        f"a trial belongs at {root / LAYOUT}; an action is one of {', '.join(FOLDERS)}"
    )
    if not read and has_logs(root):
        step += f"; logs of another program: {import_command(root)}"
    return [Missing("advice" if read else "error", str(root), what, step)]


def _cells(found: Found) -> list[Cell]:
    """The figures of each cell, in order of first sight; its mass is that of its first trial."""
    by_name: dict[CellName, list[TimedTrial | None]] = {}
    for name, trial in found:
        by_name.setdefault(name, []).append(trial)

    cells = []
    for name, trials in by_name.items():
        read = [trial for trial in trials if trial]
        recordings = [trial.recording for trial in read]
        mass = next((trial.mass for trial in read if trial.mass), None)
        cell = Cell(
            *name,
            trials=len(trials),
            read=len(read),
            seconds=sum(len(one.samples) / one.rate_hz for one in recordings),
            mass_g=mass.mass_g if mass else None,
            mass_from=mass.source if mass else None,
            labels_by=dict(Counter(trial.labels_by for trial in read)),
        )
        cells.append(cell)
    return cells


# -- what more data would bring


def _advise(where: Path | str, what: str, step: str) -> Missing:
    return Missing("advice", str(where), what, step)


def _advice(
    report: FolderReport, root: Path, trials: Sequence[TimedTrial], *, all_read: bool
) -> Iterator[Missing]:
    """Unit, people, masses, situations, weights, labels; all_read: else only the first three."""
    # The recorder writes unit and labels itself; only folders made by hand can lack them.
    bare = report.layout == "thesis"
    if bare and "unit" not in read_json(root / META):
        units = " or ".join(f'{{"unit": "{unit}"}}' for unit in UNITS)
        yield _advise(root / META, "no unit; N is assumed", f"write {units}")

    people = {trial.recording.person for trial in trials} - {None}
    if len(people) < 2:
        named = f"one person, {people.pop()}" if people else "no people"
        held_out = f"figures are held out by {report.held_out_by}"
        what = f"{named}: {held_out} and do not apply to other people"
        step = f"sort trials of several people into {LAYOUT}"
        yield _advise(root, what, step)

    for trial in trials:
        recording = trial.recording
        if trial.has_object and trial.heavy is None:
            # The folder of the object is two above the file of the trial.
            folder = root / Path(recording.trial_id).parent.parent
            what = f"no mass given for object {recording.object_name!r}: {NO_WEIGHT}"
            yield _advise(folder, what, weigh_it(folder))
        lost = [stop - first for first, stop in lost_spans(recording.valid)]
        if lost:
            total_s, longest_s = np.array([sum(lost), max(lost)]) / recording.rate_hz
            gaps = f"{count_of(len(lost), 'gap')} of {total_s:.2f} s together"
            what = f"{gaps}, the longest of {longest_s:.2f} s"
            step = "nothing: they are lost samples, and the answer is unknown over them"
            yield _advise(recording.trial_id, what, step)

    by_noise = [one.contact_on for one in trials if one.contact_on is not None]
    if by_noise:
        low, high = (f"{limit:.3g}" for limit in (min(by_noise), max(by_noise)))
        span = low if low == high else f"{low} to {high}"
        what = f"contact in {in_words(len(by_noise), 'trial')} of lifts is what exceeds {span} "
        what += f"{report.unit}: {NOISES:g} times the noise of the first rest"
        yield _advise(root, what, f"where that is wrong, write {PHASES}")

    if all_read:
        yield from _missing_situations(report.windows, root, in_n=report.unit == "N")
    scripted = [one for one in trials if one.labels_by.startswith(thesis.BY_SCRIPT)]
    if all_read and bare and scripted:
        truth = truth_path(root / f"{scripted[0].recording.trial_id}.csv")
        share = f"{len(scripted)} of {len(trials)} trials"
        what = f"{share} have labels by the script, not measured ones"
        step = f"where you know the times, write {PHASES}"
        yield _advise(truth, what, step)


def _missing_situations(
    windows: dict[str, int], root: Path, *, in_n: bool
) -> Iterator[Missing]:
    """Situations without a window, and those with light or with heavy objects alone."""
    # Situation by situation; where a mass is not known, no weight is learned whatever there is.
    counts = np.reshape(list(windows.values()), (len(SITUATIONS), -1))
    present = counts.max(axis=1) > 0
    # Of one situation alone there is nothing to learn.
    alone = present.sum() < 2
    for number, situation in enumerate(SITUATIONS):
        step = f"record {root / RECORD[situation]}/trial_1.csv"
        # In N a model knows an empty hand by its force, and learns nothing of it.
        if not present[number] and (alone or not (in_n and number == NOTHING)):
            what = f"no {situation}: a model cannot tell it"
            yield Missing("training" if alone else "advice", str(root), what, step)
        elif number != NOTHING and not counts[number].all():
            lacks = "heavy" if counts[number, 0] else "light"
            what = f"no {situation} with a {lacks} object: {NO_WEIGHT}"
            yield _advise(root, what, step)


# -- as lines for people


def report_lines(report: FolderReport) -> list[str]:
    """The report as lines for people."""
    lines = [f"{report.folder}: no recording can be read"]
    if report.held_out_by is not None:
        lines = _summary(report, report.held_out_by)
    if report.cells:
        lines += ["", *_aligned([HEADS, *map(_row, report.cells)])]
    if report.windows:
        lines += ["", f"to learn from: {counts_in_words(report.windows)}"]

    # One line for many faults of a kind: a folder of a hundred trials would fill the screen.
    # Numbers are left out of the comparison: "at 49 Hz" and "at 51 Hz" are the same fault.
    kinds = by_kind(
        report.missing, lambda one: re.sub(r"[0-9.]+", "#", f"{one.level} {one.what}")
    )
    for first, *others in kinds.values():
        lines += ["", f"{LEVELS[first.level]} {first.where}: {first.what}"]
        lines.append(f"  -> {first.next_step}")
        if others:
            places = [one.where.removeprefix(f"{report.folder}/") for one in others]
            named = f": {', '.join(places)}" if first.level == "error" else ""
            lines.append(f"  {len(others)} more like it{named}")

    verdict = "ready for holdfast train and holdfast evaluate"
    if "doubt" in report.levels:
        verdict += (
            "; look at each DOUBTFUL line first: if it is right, the figures are wrong"
        )
    if not report.readable:
        verdict = "not ready: correct each ERROR, then run holdfast check again"
    elif not report.trainable:
        verdict = (
            "ready for holdfast evaluate; holdfast train needs what FOR TRAINING says"
        )
    elif report.layout not in FORMATS:
        verdict = "a public set, read as it is"

    return [*lines, "", verdict]


def _summary(report: FolderReport, held_out_by: str) -> list[str]:
    """The first lines of a report: how much was read, and what is held out together."""
    trials, seconds = 0, 0.0
    people = set()
    for cell in report.cells:
        trials += cell.trials
        seconds += cell.seconds
        people |= {cell.person} - {None}
    of = f" of {in_words(len(people), 'person')}" if people else ""
    form = FORMATS.get(report.layout or "", "a public set")
    silent = ", ".join(report.not_measured)
    return [
        f"{report.folder}: {in_words(trials, 'trial')}{of}, {seconds / 60.0:.1f} min, "
        f"{report.channels} channels in {report.unit} at {report.rate_hz:g} Hz; {form}",
        *([f"not measured, by {HAND_FILE}: {silent}"] if silent else []),
        f"held out by {held_out_by}: {in_words(report.groups, held_out_by)}",
        *report.not_held_out,
    ]


def _row(cell: Cell) -> tuple[str, ...]:
    """A cell as texts, one for each of HEADS; what is not known is "-"."""
    unread = cell.trials - cell.read
    mass = "-"
    if cell.mass_g is not None:
        mass = f"{cell.mass_g:g} ({Path(cell.mass_from or '').name})"
    return (
        cell.person or "-",
        cell.object_name or "hand alone",
        cell.action or "-",
        f"{cell.trials} ({unread} unread)" if unread else f"{cell.trials}",
        mass,
        ", ".join(cell.labels_by) or "-",
    )


def _aligned(rows: Sequence[Sequence[str]]) -> list[str]:
    """Rows of texts as lines, each column as wide as its widest text."""
    widths = [max(map(len, column)) for column in zip(*rows, strict=True)]
    lines = []
    for row in rows:
        cells = map(str.ljust, row, widths)
        lines.append("  ".join(cells).rstrip())

    return lines
