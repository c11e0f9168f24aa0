"""Logs become trials by a map, and trials a set: cut, named, labelled, checked, written.

Log by log, so that only one is in the memory; the folder appears whole or not at all. A fault is
noted and the reading goes on. What was left out or filled is counted in a `Tally`.
"""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path

import msgspec
import numpy as np

from holdfast.core.contract import (
    GRASP,
    SITUATIONS,
    FloatArray,
    IntArray,
    Json,
    channel_names,
)
from holdfast.core.errors import (
    ColumnError,
    DataError,
    EmptyRecording,
    LabelError,
    TimeError,
    count_of,
    listed,
)
from holdfast.core.hand_card import (
    FEWEST_SENSORS,
    FINGERS_AT_MM,
    MOST_SENSORS,
    find_hand_card,
)
from holdfast.core.trial_file import (
    TIME_COLUMN,
    Trial,
    implausible_rate,
    places_by_time,
)
from holdfast.core.trial_layout import (
    HAND_FILE,
    LABELLED_ACTIONS,
    MASSES_KEY,
    META,
    UNSCRIPTED,
    truth_path,
)
from holdfast.core.writing import write_whole
from holdfast.interop.columns import usual_step, words_of
from holdfast.interop.labels import (
    Event,
    events_of_cells,
    events_of_table,
    held,
    in_ns,
)
from holdfast.interop.logs import LogPlace, read_log, table_of
from holdfast.interop.map import NAMES, EventRules, ImportMap, map_text
from holdfast.interop.streams import LOG_TIME, ForeignLog, text_cells
from holdfast.interop.tables import pd
from holdfast.training.datasets.thesis import prepared
from holdfast.training.datasets.trials import EMPTY_HAND
from holdfast.training.progress import Part, ignored
from holdfast.training.timeline import contact

MAP_FILE = "import.toml"
"""The map, kept with what it made."""
PROVENANCE = "events"
"""What a truth file says of where its phases come from."""
JUMP_S, BACK_S = 60.0, 0.5
"""A clock that jumps on by so much, or back, begins a new trial."""
GAP_STEPS = 5.0
MOST_FILLED = 20
"""A trial has at most so many rows for each row of its log."""
THESIS_SENSORS = 6
"""Of a set without a hand card."""
NO_LABEL = -1


@dataclass(frozen=True)
class ImportFault:
    """What keeps a log from being imported."""

    where: str
    what: str
    next_step: str


@dataclass
class Tally:
    """What was found in all logs. missing: column -> cells. gaps_s: of lost samples."""

    rows: int = 0
    missing: Counter[str] = field(default_factory=Counter)
    gaps_s: list[float] = field(default_factory=list)
    trials: Counter[tuple[str, ...]] = field(default_factory=Counter)
    labels: Counter[str] = field(default_factory=Counter)
    notes: list[str] = field(default_factory=list)

    def lines(self) -> list[str]:
        """The end of the table of what was understood."""
        lines = [f"rows       {self.rows}"]
        missing = [f"{name}: {n}" for name, n in self.missing.most_common() if n]
        if missing:
            lines.append(f"missing    samples of {listed(missing, most=8)}")
        if self.gaps_s:
            ends = f"{min(self.gaps_s):.3g} to {max(self.gaps_s):.3g} s"
            lines.append(f"gaps       {len(self.gaps_s)} of {ends}: lost samples")
        by_action = Counter[str]()
        for names, count in self.trials.items():
            by_action[names[-1]] += count
        actions = [f"{count} {action}" for action, count in by_action.items()]
        lines.append(
            f"trials     {count_of(self.trials.total(), 'trial')}: {listed(actions)}"
        )
        people = [names[0] for names in self.trials if names[0]]
        if people:
            lines.append(f"people     {listed(list(dict.fromkeys(people)), most=12)}")
        return lines + [f"note       {note}" for note in self.notes[:12]]


@dataclass(frozen=True)
class _Rows:
    """Rows of a log: stamps [T] ns, values [T, C] in the model's unit, cells [T] of further columns."""

    stamps: IntArray
    values: FloatArray
    cells: dict[str, np.ndarray]

    def part(self, rows: slice | IntArray) -> _Rows:
        """Some of the rows."""
        cells = {name: column[rows] for name, column in self.cells.items()}
        return _Rows(self.stamps[rows], self.values[rows], cells)


class TrialImport:
    """Reads logs by a map and writes their trials into a folder."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder
        self.tally = Tally()
        self.faults: list[ImportFault] = []
        self.written: dict[str, str] = {}
        self._numbers: Counter[str] = Counter()

    def take(
        self,
        source: Path,
        plan: ImportMap,
        places: Sequence[LogPlace],
        part: Part = ignored,
    ) -> None:
        """The logs of one map. part: receives the share that is read."""
        chosen = [
            one
            for one in places
            if not any(fnmatch(one.name, skip) for skip in plan.trials.skip)
        ]
        used: Counter[Path] = Counter()
        files = by_trial(chosen, plan.trials.fingers)
        for number, (name, group) in enumerate(files.items(), 1):
            place = replace(group[0], name=name)
            try:
                log = read_joined(group, plan.trials.fingers, name)
                table = _Events(source, plan, place)
                self._read(log, plan, place, table)
                used[table.path] += table.n_used
            except DataError as error:
                self._fault(error, place.path)
            part(number / len(files))
        for path, count in used.items():
            if not count and path != Path():
                what = "no event of it lies in a log"
                step = "correct unit and zero of [events] in the map"
                self.faults.append(ImportFault(str(path), what, step))

    def _fault(self, error: DataError, path: Path) -> None:
        cause = f" ({error.cause})" if error.cause else ""
        where = error.where or str(path)
        self.faults.append(ImportFault(where, error.what + cause, error.next_step))

    def _read(
        self, log: ForeignLog, plan: ImportMap, place: LogPlace, events: _Events
    ) -> None:
        rows = rows_of(log, plan, self.tally)
        cuts = list(cuts_of(rows, plan, self.tally, place.name))
        if not cuts:
            raise EmptyRecording("no trial in it", where=place.path)
        for number, cut in enumerate(cuts, 1):
            source = place.name if len(cuts) == 1 else f"{place.name} (trial {number})"
            where = (
                place.path if len(cuts) == 1 else Path(f"{place.path}, trial {number}")
            )
            try:
                self._trial(log, cut, plan, place, events, source, where)
            except DataError as error:
                self._fault(error, where)

    def _trial(
        self,
        log: ForeignLog,
        rows: _Rows,
        plan: ImportMap,
        place: LogPlace,
        events: _Events,
        source: str,
        where: Path,
    ) -> None:
        names = _names(log, rows, plan, place, where)
        trial = trial_of_rows(rows, plan, where, self.tally)
        labels = labels_of_rows(log, rows, trial, plan, events, place)
        kinds = {SITUATIONS[k] for k in np.unique(labels[labels >= 0]).tolist()}
        action = names["action"] or _action_of(kinds)
        if not action:
            raise LabelError(
                "nothing says what happens in this trial",
                where=where,
                next_step="--action slip, or another action",
            )
        needs = action in UNSCRIPTED and action not in LABELLED_ACTIONS
        if needs and not kinds:
            raise LabelError(
                f"a {action!r} needs its events, and there is none in the trial",
                where=where,
                next_step="correct [events] of the map, or leave it out: [trials] skip",
            )
        parts = [names["person"], names["object"] or "object", action]
        if action == EMPTY_HAND:
            parts = [names["person"], EMPTY_HAND]
        folder = "/".join(part for part in parts if part)
        self._numbers[folder] += 1
        name = f"{folder}/trial_{self._numbers[folder]}.csv"
        path = self.folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_csv(path, trial)
        if kinds and action != EMPTY_HAND:
            write_whole(truth_path(path), truth_of(trial, labels))
        self.tally.trials[tuple(parts)] += 1
        self.tally.labels.update(kinds)
        self.written[name] = source

    def finish(self, plan: ImportMap, hand_folder: Path) -> None:
        """Write what is beside the trials: meta.json, the map, the hand card."""
        facts = {
            key: value
            for key, value in msgspec.to_builtins(plan.facts).items()
            if key not in NAMES and value is not None
        }
        meta: Json = {"unit": plan.unit_of_values, "kind": "recorded", **facts}
        if plan.masses_g:
            meta[MASSES_KEY] = dict(plan.masses_g)
        meta["imported"] = self.written
        write_whole(self.folder / META, json.dumps(meta, indent=1) + "\n")
        card = hand_card_text(plan, hand_folder)
        if card:
            write_whole(self.folder / HAND_FILE, card)
            plan = msgspec.structs.replace(plan, hand=HAND_FILE)
        write_whole(self.folder / MAP_FILE, map_text(plan))


def by_trial(
    places: Sequence[LogPlace], fingers: Sequence[str]
) -> dict[str, list[LogPlace]]:
    """Name of a trial -> its files: one, or one for each finger in the order of `fingers`."""
    files: dict[str, list[LogPlace]] = {}
    for place in places:
        name, _ = without_finger(place.name, fingers)
        files.setdefault(name, []).append(place)
    for group in files.values():
        group.sort(key=lambda one: without_finger(one.name, fingers)[1])
    return files


def without_finger(name: str, fingers: Sequence[str]) -> tuple[str, int]:
    """(a name without the word of a finger, which of the words it had)."""
    for k, word in enumerate(fingers):
        parts = name.split(word)
        if len(parts) == 2:
            joint = (parts[0].rstrip("_-. /"), parts[1].lstrip("_-. /"))
            return "_".join(filter(None, joint)) or "log", k
    return name, len(fingers)


def read_joined(
    places: Sequence[LogPlace], fingers: Sequence[str], name: str
) -> ForeignLog:
    """One log of one file, or of a file for each finger: then its columns are `finger.column`."""
    from holdfast.interop.columns import find_time
    from holdfast.interop.streams import Stream

    if not fingers:
        return read_log(places[0])
    streams = []
    for place in places:
        word = fingers[without_finger(place.name, fingers)[1]]
        log = read_log(place)
        columns = max(log.streams, key=lambda one: one.rows).columns
        time = find_time(columns)
        if time is None:
            raise TimeError("no column of time to join the files by", where=place.path)
        unit_ns = time.time.unit_ns
        t_ns = np.round(columns.pop(time.time.column).astype(np.float64) * unit_ns)
        named = {f"{word}.{key}": column for key, column in columns.items()}
        streams.append(Stream(named, t_ns.astype(np.int64), word))
    return ForeignLog(places[0].path, name, tuple(streams))


# -- rows of a log


def rows_of(log: ForeignLog, plan: ImportMap, tally: Tally) -> _Rows:
    """The readings of a log by the map; rows without a time are left out. Raises ColumnError, .."""
    columns = table_of(log, plan.channels)
    plan.require_columns(columns, log.path)
    values = plan.values_of(columns, log.path)
    further = [
        plan.trials.column,
        plan.trials.person,
        plan.trials.object,
        plan.trials.action,
    ]
    if plan.events is not None and plan.events.column in columns:
        further.append(plan.events.column)
    cells = {}
    for name in filter(None, further):
        if name not in columns:
            raise ColumnError(
                f"no column {name} (trials)",
                where=log.path,
                next_step="correct the column map",
            )
        cells[name] = np.array(text_cells(columns[name]), dtype=object)
    tally.rows += len(values)
    for channel, name in enumerate(plan.channels):
        tally.missing[name] += int(np.count_nonzero(~np.isfinite(values[:, channel])))
    for stream in log.streams:
        tally.notes += [f"{log.path.name}: {note}" for note in stream.notes]
    time = columns.get(plan.time.column, np.zeros(len(values), dtype=np.int64))
    there = np.isfinite(time)
    if not there.all():
        tally.notes.append(
            f"{log.path.name}: {count_of(int((~there).sum()), 'row')} without a time left out"
        )
        columns = {plan.time.column: time[there]}
        rows = _Rows(np.zeros(len(time), np.int64), values, cells).part(
            np.flatnonzero(there)
        )
        values, cells = rows.values, rows.cells
    stamps = plan.stamps_ns(columns, len(values), log.path)
    return _Rows(unwrapped(stamps, plan.time.unit_ns), values, cells)


def unwrapped(stamps: IntArray, unit_ns: float) -> IntArray:
    """Stamps of a counter of 8, 16 or 32 bits that began anew, on one line."""
    steps = np.diff(stamps)
    for bits in (8, 16, 32):
        period = int(unit_ns * 2.0**bits)
        back = steps < -0.9 * period
        if back.any() and (steps[back] > -1.01 * period).all():
            anew = np.concatenate([[0], np.cumsum(back)])
            return stamps + period * anew
    return stamps


def cuts_of(rows: _Rows, plan: ImportMap, tally: Tally, name: str) -> Iterator[_Rows]:
    """The rows of each trial, on an even clock."""
    stamps = rows.stamps
    step = usual_step(stamps.astype(np.float64))
    steps = np.diff(stamps)
    jumps = (steps < -1e9 * BACK_S) | (steps > 1e9 * JUMP_S)
    for at in np.flatnonzero(jumps)[:3].tolist():
        tally.notes.append(
            f"{name}: the clock jumps by {1e-9 * steps[at]:.4g} s in row {at + 2}: a new trial"
        )
    ends = jumps | (steps > 1e9 * plan.trials.gap_s) if plan.trials.gap_s else jumps
    column = plan.trials.column
    if column:
        cells = rows.cells[column]
        ends |= cells[1:] != cells[:-1]
    bounds = [0, *(np.flatnonzero(ends) + 1).tolist(), len(stamps)]
    for first, stop in pairwise(bounds):
        part = rows.part(slice(first, stop))
        # rows between trials have no name
        if column and not cells[first]:
            continue
        if stop - first < 10:
            tally.notes.append(
                f"{name}: {count_of(stop - first, 'row')} between trials left out"
            )
            continue
        order = np.argsort(part.stamps, kind="stable")
        moved = int(np.count_nonzero(order != np.arange(len(order))))
        if moved:
            tally.notes.append(
                f"{name}: {count_of(moved, 'row')} put in the order of their stamps"
            )
            part = part.part(order)
        yield replace(part, stamps=evened(part.stamps, step))


def evened(stamps: IntArray, step: float) -> IntArray:
    """Stamps [T] that arrive in bursts, or far from evenly, on a line through each unbroken run."""
    steps = np.diff(stamps).astype(np.float64)
    is_even = np.mean(np.abs(steps - step) <= 0.5 * step) > 0.9
    if is_even and (steps > 0).all():
        return stamps
    usual = float(np.median(steps[steps > 0]))
    gaps = np.flatnonzero(steps > max(GAP_STEPS * step, 3.0 * usual)) + 1
    runs = []
    end = -np.inf
    for first, stop in pairwise([0, *gaps.tolist(), len(stamps)]):
        k = np.arange(stop - first)
        run = stamps[first] + step * k
        if len(k) > 20:
            middle = float(np.mean(stamps[first:stop] - stamps[first]))
            run = stamps[first] + middle + step * (k - k.mean())
        # the line of a short run may begin before the one before it ends
        run = run + max(0.0, end + step - run[0])
        runs.append(run)
        end = run[-1]
    even: IntArray = np.round(np.concatenate(runs)).astype(np.int64)
    return even


def trial_of_rows(rows: _Rows, plan: ImportMap, where: Path, tally: Tally) -> Trial:
    """The trial of some rows: rows that never came are nan. Raises TimeError, EmptyRecording."""
    values = np.where(np.isfinite(rows.values), rows.values, np.nan)
    first = _first_whole(values)
    if first:
        tally.notes.append(
            f"{where.name}: {count_of(first, 'row')} before all sensors sent left out"
        )
    t_s = 1e-9 * (rows.stamps[first:] - rows.stamps[first])
    step_s = float(np.median(np.diff(t_s)))
    wrong = (
        implausible_rate(1.0 / step_s) if step_s > 0 else "has no usual step of time"
    )
    place = places_by_time(t_s) if step_s > 0 else np.arange(len(t_s))
    if wrong or place[-1] > MOST_FILLED * len(place):
        raise TimeError(
            wrong or "has more gaps than rows",
            where=where,
            next_step="give the rate: --rate HZ; or correct [time] of the map",
        )
    lost = np.diff(t_s)[np.diff(place) > 1]
    tally.gaps_s += lost[lost > GAP_STEPS * step_s].tolist()
    whole = np.full((place[-1] + 1, values.shape[1]), np.nan)
    whole[place] = values[first:]
    every_s = np.interp(np.arange(len(whole)), place, t_s)
    valid = np.ones((len(whole), values.shape[1] // 3), dtype=np.bool_)
    return Trial(where, every_s, whole, valid)


def _first_whole(values: FloatArray) -> int:
    """The first row in which every sensor that ever sends has sent; 0 if that is late."""
    there = np.isfinite(values)
    sends = there.any(axis=0)
    first = int(there[:, sends].argmax(axis=0).max()) if sends.any() else 0
    return first if first < len(values) // 2 else 0


# -- labels of a trial


class _Events:
    """The table of events of a log, if the map has one."""

    def __init__(self, source: Path, plan: ImportMap, place: LogPlace) -> None:
        self.rules = plan.events
        self.path, self.events, self.n_used = Path(), [], 0
        if self.rules is None or not self.rules.file:
            return
        root = source if source.is_dir() else source.parent
        stem = place.path.with_suffix("") if place.path.is_file() else place.path
        name = self.rules.file.replace("{name}", stem.name)
        beside = place.path.parent / name
        self.path = (
            beside if "{name}" in self.rules.file and beside.is_file() else root / name
        )
        if "{name}" in self.rules.file and not self.path.is_file():
            self.path = Path()
            return
        columns = table_of_events(self.path, self.rules)
        self.events = events_of_table(columns, self.rules, self.path)


def table_of_events(path: Path, rules: EventRules) -> dict[str, np.ndarray]:
    """The columns of the table of a file that has the times. Raises a DataError."""
    log = read_log(LogPlace(path, path.stem, path.suffix.lower()))
    for stream in log.streams:
        if rules.start in stream.columns:
            return stream.columns
    return log.streams[0].columns


def labels_of_rows(
    log: ForeignLog,
    rows: _Rows,
    trial: Trial,
    plan: ImportMap,
    table: _Events,
    place: LogPlace,
) -> np.ndarray:
    """[T] the situation of each row of a trial, -1 for none. Raises LabelError."""
    labels = np.full(len(trial.t_s), NO_LABEL, dtype=np.int8)
    rules = plan.events
    if rules is None:
        return labels
    begin = int(rows.stamps[-1]) - round(1e9 * float(trial.t_s[-1]))
    events = _events_of(log, rows, plan, rules, table, place)
    # what lasts shorter lies within what lasts longer
    for event in sorted(events, key=lambda one: one.start - one.end):
        first, stop = np.searchsorted(
            trial.t_s, 1e-9 * (np.array([event.start, event.end]) - begin) - 1e-6
        )
        situation = plan.situation(event.label)
        if situation is None and event.label and stop > first:
            raise LabelError(
                f"the label {event.label!r:.60} is no situation",
                where=table.path if rules.file else place.path,
                next_step=f'--action "{event.label:.60}=slip" (or hold, pass, ..), or '
                "[events.labels] of the map",
            )
        if situation and stop > first:
            table.n_used += event.start >= begin - 1e6
            labels[first:stop] = SITUATIONS.index(situation)
    if rules.rest:
        samples = prepared(trial, plan.unit_of_values, "").samples
        first, stop = contact(trial.t_s, samples)
        held_rows = np.zeros(len(labels), dtype=np.bool_)
        held_rows[first:stop] = True
        labels[held_rows & (labels == NO_LABEL)] = SITUATIONS.index(rules.rest)
        if (
            rules.hold
            and rules.rest == SITUATIONS[GRASP]
            and "nothing" not in rules.labels.values()
        ):
            labels[~held_rows] = NO_LABEL
    return labels


def _events_of(
    log: ForeignLog,
    rows: _Rows,
    plan: ImportMap,
    rules: EventRules,
    table: _Events,
    place: LogPlace,
) -> list[Event]:
    """The events of a trial, ns on the clock of its rows."""
    if rules.column in rows.cells:
        cells = rows.cells[rules.column].tolist()
        if rules.hold:
            cells = held([cell if cell in rules.labels else "" for cell in cells])
        return events_of_cells(cells, rows.stamps)
    if rules.column:
        return _events_of_stream(log, rows, plan, rules)
    keys = {
        place.name,
        place.path.name,
        place.path.stem,
        Path(place.name).name,
        *_numbers(place),
    }
    if plan.trials.column:
        keys = {*rows.cells[plan.trials.column], *keys}
    plain = {key.casefold() for key in keys}
    events = [
        one for one in table.events if not one.trial or one.trial.casefold() in plain
    ]
    zero_ns = 0 if rules.zero == "clock" else int(rows.stamps[0])
    return [in_ns(event, rules, rows.stamps, zero_ns) for event in events]


def _numbers(place: LogPlace) -> list[str]:
    """The number of a trial as a table of events may write it: the last one of its name."""
    digits = "".join(c if c.isdecimal() else " " for c in Path(place.name).name).split()
    return [str(int(digits[-1]))] if digits else []


def _events_of_stream(
    log: ForeignLog, rows: _Rows, plan: ImportMap, rules: EventRules
) -> list[Event]:
    """The texts of a topic of their own; its stamps are those of the log."""
    stream = next((one for one in log.streams if rules.column in one.columns), None)
    if stream is None or stream.t_ns is None:
        return []
    times = stream.t_ns
    columns = table_of(log, plan.channels)
    if plan.time.column != LOG_TIME and LOG_TIME in columns:
        # the samples have stamps of their sender
        own = plan.stamps_ns(columns, len(columns[LOG_TIME]), log.path)
        times = times + np.interp(
            times, columns[LOG_TIME], own - columns[LOG_TIME]
        ).astype(np.int64)
    return events_of_cells(text_cells(stream.columns[rules.column]), times)


def _action_of(kinds: set[str]) -> str:
    """The action of a trial of which only situations are known; "" where none is."""
    slips = kinds & {"safe_slip", "risky_slip"}
    if len(slips) == 2:
        return "daily"
    if slips:
        return "slip" if "risky_slip" in slips else "pass"
    return "hold" if "grasp" in kinds else EMPTY_HAND if kinds else ""


def _names(
    log: ForeignLog, rows: _Rows, plan: ImportMap, place: LogPlace, where: Path
) -> dict[str, str]:
    """Person, object and action of a trial: by the path, by columns, by what is always so."""
    rules = plan.trials
    names = {
        key: str(getattr(plan.facts, key) or log.about.get(key) or "") for key in NAMES
    }
    names |= rules.names_of(place.name, place.path)
    for key in NAMES:
        column = getattr(rules, key)
        if column:
            of_trial = dict.fromkeys(cell for cell in rows.cells[column] if cell)
            if len(of_trial) > 1:
                raise LabelError(
                    f"column {column} (trials.{key}) has several values in one trial: "
                    f"{', '.join(list(of_trial)[:4])}",
                    where=where,
                    next_step="split the log there: [trials] column",
                )
            names[key] = next(iter(of_trial), names[key])
    word = names["action"]
    action = plan.action(word) if word else ""
    if action is None:
        raise LabelError(
            f"the word {word!r:.60} is no action",
            where=where,
            next_step=f'--action "{word:.60}=slip" (or hold, pass, pull, ..)',
        )
    return {key: safe_name(value) for key, value in names.items()} | {"action": action}


def safe_name(text: str) -> str:
    """A name as a folder: letters, digits and dashes.

    >>> safe_name("Soft ball #2")
    'Soft-ball-2'
    """
    plain = "".join(
        c if c.isascii() and (c.isalnum() or c in "_-") else " " for c in text
    )
    return "-".join(plain.split()).strip("-_")[:60]


# -- files


def write_csv(path: Path, trial: Trial) -> None:
    """The samples as the layout has them; a lost value is nan."""
    table = pd.DataFrame(
        trial.raw.round(9), columns=list(channel_names(trial.raw.shape[1] // 3))
    )
    table.insert(0, TIME_COLUMN, trial.t_s.round(9))
    table.to_csv(path, index=False, na_rep="nan")


def truth_of(trial: Trial, labels: np.ndarray) -> str:
    """The phases of a trial: runs of equal labels [T]."""
    changes = (np.flatnonzero(np.diff(labels)) + 1).tolist()
    end_s = float(trial.t_s[-1]) + 1.0 / trial.rate_hz
    times_s = [*trial.t_s.tolist(), end_s]
    phases = []
    for first, stop in pairwise([0, *changes, len(labels)]):
        if labels[first] != NO_LABEL:
            phase = {"t0_s": round(times_s[first], 6), "t1_s": round(times_s[stop], 6)}
            phases.append(
                {**phase, "label": SITUATIONS[labels[first]], "provenance": PROVENANCE}
            )
    return json.dumps({"phases": phases}, indent=1) + "\n"


def hand_card_text(plan: ImportMap, folder: Path) -> str:
    """The hand card of a set: what the map names, else one that is proposed for its sensors.

    "" for six sensors without a card, which are the fingertips, and where no card has so many.
    """
    if plan.hand:
        return find_hand_card(plan.hand, folder).read_text("utf-8")
    n_sensors = len(plan.sensors)
    if n_sensors == THESIS_SENSORS or not FEWEST_SENSORS <= n_sensors <= MOST_SENSORS:
        return ""
    # the thumb's side comes first in a card: by the names, else a third of the sensors
    n_thumb = sum("thumb" in words_of(sensor.x) for sensor in plan.sensors)
    if not 0 < n_thumb < n_sensors:
        n_thumb = max(1, n_sensors // 3)
    lines = [
        f'name = "imported-{n_sensors}-sensors"',
        'about = "Proposed by holdfast import: correct sides and places"',
    ]
    for k, sensor in enumerate(plan.sensors):
        side, of_side = (
            ("thumb", n_thumb) if k < n_thumb else ("opposing", n_sensors - n_thumb)
        )
        place = k if k < n_thumb else k - n_thumb
        along_mm = (
            FINGERS_AT_MM[0] * (1.0 - 2.0 * place / (of_side - 1))
            if of_side > 1
            else 0.0
        )
        heads = f"[[sensors]]  # {', '.join(sensor.axes)}".replace("\n", " ")
        lines += ["", heads, f'name = "sensor-{k + 1}"', f'side = "{side}"']
        lines.append(f"along_mm = {along_mm:.1f}")
    return "\n".join(lines) + "\n"
