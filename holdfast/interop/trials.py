"""Logs become trials by a map: joined, cut, put on an even clock, named, labelled, written.

Log by log, so that only one is in the memory. What was left out or filled is counted and printed.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field, replace
from itertools import pairwise
from pathlib import Path

import numpy as np

from holdfast.core.contract import SITUATIONS, FloatArray, IntArray
from holdfast.core.errors import LabelError, TimeError, count_of, listed
from holdfast.core.trial_file import Trial, implausible_rate, places_by_time
from holdfast.core.trial_layout import (
    LABELLED_ACTIONS,
    SITUATION_OF_ACTION,
    UNSCRIPTED,
    truth_path,
)
from holdfast.core.writing import write_whole
from holdfast.interop.columns import find_time, touch, usual_step
from holdfast.interop.labels import Event, held, in_ns, read_events, runs_of
from holdfast.interop.logs import LogPlace, read_log, table_of
from holdfast.interop.map import NAMES, ImportMap
from holdfast.interop.streams import (
    FEWEST_ROWS,
    GAP_STEPS,
    ForeignLog,
    Stream,
    evened,
    first_stream,
    text_cells,
    unwrapped,
)
from holdfast.interop.writing import NO_LABEL, truth_of, write_csv
from holdfast.training.datasets.thesis import prepared
from holdfast.training.datasets.trials import EMPTY_HAND
from holdfast.training.progress import Part, ignored
from holdfast.training.timeline import ACTION_S, contact

JUMP_S, BACK_S = 60.0, 0.5
"""A clock that jumps on by so much, or back, begins a new trial."""
LONG_GAP_S, LONG_GAP_STEPS = 0.5, 20.0
"""A gap with the open hand ends a trial from so many seconds and so many usual steps on."""
MOST_FILLED = 20
"""A trial has at most so many rows for each row of its log."""
TIMED = ("pull", "fall", "pass", "put-down")
"""Actions whose times a log gives, else the thesis' script."""
Files = dict[str, list[LogPlace]]
"""Name of a log -> its file, or a file for each finger."""


@dataclass(frozen=True)
class Rows:
    """Rows of a log: stamps [T] ns, values [T, C] in the model's unit, cells [T] of columns."""

    stamps: IntArray
    values: FloatArray
    cells: dict[str, np.ndarray]

    def part(self, rows: slice | np.ndarray) -> Rows:
        """Some of the rows."""
        cells = {name: column[rows] for name, column in self.cells.items()}
        return Rows(self.stamps[rows], self.values[rows], cells)


@dataclass
class TrialImport:
    """Reads logs by a map and writes their trials into a folder.

    written: trial -> its log. missing: column -> cells. gaps_s: of lost samples.
    """

    folder: Path
    written: dict[str, str] = field(default_factory=dict)
    rows: int = 0
    missing: Counter[str] = field(default_factory=Counter)
    gaps_s: list[float] = field(default_factory=list)
    trials: list[list[str]] = field(default_factory=list)
    notes: list[str] = field(default_factory=list)

    def take(
        self, source: Path, plan: ImportMap, files: Files, part: Part = ignored
    ) -> None:
        """The logs of one map. part: receives the share that is read. Raises a DataError."""
        events: Counter[Path] = Counter()
        for number, (name, group) in enumerate(files.items(), 1):
            log = read_joined(group, plan.trials.fingers, name)
            for stream in log.streams:
                self.notes += [f"{name}: {note}" for note in stream.notes]
            path, of_file = read_events(source, plan.events, group[0].path)
            whole = self._rows(log, plan)
            # a long log is large
            log = replace(log, streams=())
            for rows in self._cuts(whole, plan, name):
                events[path] += self._write(log, rows, plan, of_file)
            part(number / len(files))

        for path, n_used in events.items():
            if path != Path() and not n_used:
                raise LabelError(
                    "no event of it lies in a log",
                    where=path,
                    next_step="correct unit and zero of [events] in the map",
                )

    def lines(self) -> list[str]:
        """The end of the table of what was understood."""
        lines = [f"rows       {self.rows}"]
        missing = [f"{name}: {n}" for name, n in self.missing.most_common() if n]
        if missing:
            lines.append(f"missing    samples of {listed(missing, most=8)}")
        if self.gaps_s:
            ends = f"{min(self.gaps_s):.3g} to {max(self.gaps_s):.3g} s"
            lines.append(f"gaps       {len(self.gaps_s)} of {ends}: lost samples")

        people, _, actions = zip(*self.trials, strict=True)
        counts = [f"{n} {action}" for action, n in Counter(actions).items()]
        n_trials = count_of(len(self.trials), "trial")
        lines.append(f"trials     {n_trials}: {listed(counts)}")
        named = list(filter(None, dict.fromkeys(people)))
        if named:
            lines.append(f"people     {listed(named, most=12)}")
        return lines + [f"note       {note}" for note in self.notes[:12]]

    # -- rows of a log, and where a trial ends

    def _rows(self, log: ForeignLog, plan: ImportMap) -> Rows:
        """The readings of a log; rows without a time are left out. Raises ColumnError, .."""
        columns = table_of(log, plan.channels)
        rules = plan.trials
        further = {rules.column, rules.person, rules.object, rules.action} - {""}
        plan.require_columns(columns, log.path, {*plan.columns, *further})
        if plan.events is not None:
            further |= {plan.events.column} & columns.keys()
        cells = {name: np.array(text_cells(columns[name]), object) for name in further}
        values = plan.values_of(columns, log.path)
        self.rows += len(values)
        for name, channel in zip(plan.channels, values.T, strict=True):
            self.missing[name] += int(np.count_nonzero(~np.isfinite(channel)))
        rows = Rows(np.zeros(len(values), dtype=np.int64), values, cells)
        time = columns.get(plan.time.column)
        if time is not None and not np.isfinite(time).all():
            there = np.isfinite(time)
            lost = count_of(int(np.count_nonzero(~there)), "row")
            self.notes.append(f"{log.name}: {lost} without a time left out")
            rows, columns = rows.part(there), {plan.time.column: time[there]}

        stamps = plan.stamps_ns(columns, len(rows.values), log.path)
        return replace(rows, stamps=unwrapped(stamps, plan.time.unit_ns))

    def _cuts(self, rows: Rows, plan: ImportMap, name: str) -> Iterator[Rows]:
        """The rows of each trial, on an even clock."""
        step = usual_step(rows.stamps.astype(np.float64))
        steps = 1e-9 * np.diff(rows.stamps)
        ends = (steps < -BACK_S) | (steps > JUMP_S)
        for at in np.flatnonzero(ends)[:3].tolist():
            jump = f"the clock jumps by {steps[at]:.4g} s in row {at + 2}"
            self.notes.append(f"{name}: {jump}: a new trial")

        column = rows.cells.get(plan.trials.column)
        if column is not None:
            ends |= column[1:] != column[:-1]
        else:
            ends |= _pauses(rows, max(LONG_GAP_S, LONG_GAP_STEPS * 1e-9 * step))

        for first, stop in pairwise([0, *(np.flatnonzero(ends) + 1), len(ends) + 1]):
            if column is not None and not column[first]:
                continue
            if stop - first < FEWEST_ROWS:
                self.notes.append(
                    f"{name}: {stop - first} rows between trials left out"
                )
                continue
            part = rows.part(slice(first, stop))
            order = np.argsort(part.stamps, kind="stable")
            part = part.part(order)
            yield replace(part, stamps=evened(part.stamps, step))

    # -- one trial

    def _write(
        self, log: ForeignLog, rows: Rows, plan: ImportMap, events: Sequence[Event]
    ) -> int:
        """Write a trial; how many of the events it has. Raises LabelError, TimeError."""
        names = names_of(log, rows, plan)
        trial = self._trial(rows, log.path)
        labels, n_used = labels_of_rows(log, rows, trial, plan, events)
        kinds = {SITUATIONS[k] for k in labels if k != NO_LABEL}
        action = names["action"] or _action_of(kinds)
        if action in TIMED and not kinds and not _is_scripted(trial, plan):
            if SITUATION_OF_ACTION[action] == "risky_slip":
                taken, action = "taken as slip", "slip"
            else:
                taken = "only the empty hand is labelled"
                labels = _empty_hand(trial, plan)
                kinds = {"nothing"}
            self.notes.append(f"{log.name}: its times are not known: {taken}")

        needs_events = action in UNSCRIPTED and action not in LABELLED_ACTIONS
        if not action or (needs_events and not kinds):
            raise LabelError(
                f"nothing says what happens in {log.name}",
                where=log.path,
                next_step="--action slip, or another action; or its events",
            )

        thing = "" if action == EMPTY_HAND else names["object"] or "object"
        parts = [names["person"], thing, action]
        place = "/".join(filter(None, parts))
        number = 1 + self.trials.count(parts)
        path = self.folder / place / f"trial_{number}.csv"
        write_csv(path, trial)
        if kinds and action != EMPTY_HAND:
            write_whole(truth_path(path), truth_of(trial, labels))
        self.trials.append(parts)
        self.written[f"{place}/{path.name}"] = log.name
        return n_used

    def _trial(self, rows: Rows, where: Path) -> Trial:
        """The trial of some rows: rows that never came are nan. Raises TimeError."""
        values = np.where(np.isfinite(rows.values), rows.values, np.nan)
        first = _first_whole(values)
        if first:
            lost = f"{count_of(first, 'row')} before all sensors sent left out"
            self.notes.append(f"{where.name}: {lost}")

        t_s = 1e-9 * (rows.stamps[first:] - rows.stamps[first])
        step_s = max(1e-12, float(np.median(np.diff(t_s))))
        wrong = implausible_rate(1.0 / step_s)
        place = places_by_time(t_s)
        if wrong or place[-1] > MOST_FILLED * len(place):
            raise TimeError(
                wrong or "more gaps than rows",
                where=where,
                next_step="--rate HZ; or correct [time] of the map",
            )
        lost = np.diff(t_s)[np.diff(place) > 1]
        self.gaps_s += lost[lost > GAP_STEPS * step_s].tolist()
        whole = np.full((place[-1] + 1, values.shape[1]), np.nan)
        whole[place] = values[first:]
        every_s = np.interp(np.arange(len(whole)), place, t_s)
        valid = np.ones((len(whole), values.shape[1] // 3), dtype=np.bool_)
        return Trial(where, every_s, whole, valid)


def _pauses(rows: Rows, longest_s: float) -> np.ndarray:
    """[T - 1] where no row comes for longer, and nothing is touched before and after."""
    steps = 1e-9 * np.diff(rows.stamps)
    pauses = steps > longest_s
    if pauses.any():
        touched = touch(rows.values).rows
        for at in np.flatnonzero(pauses).tolist():
            if touched[max(0, at - 5) : at + 6].mean() > 0.5:
                # a step within a touch is none, nor is one of its length
                longest_s = max(longest_s, 1.01 * float(steps[at]))
    return steps > longest_s


def _first_whole(values: FloatArray) -> int:
    """The first row in which every sensor that ever sends has sent; 0 if that is late."""
    there = np.isfinite(values)
    sends = there.any(axis=0)
    first = int(there[:, sends].argmax(axis=0).max(initial=0))
    return first if first < len(values) // 2 else 0


def _contact(trial: Trial, plan: ImportMap) -> tuple[int, int]:
    """(first row with the hand closed on something, the row after the last such)."""
    return contact(trial.t_s, prepared(trial, plan.unit_of_values, "").samples)


def _is_scripted(trial: Trial, plan: ImportMap) -> bool:
    """Whether the hand is closed when the thesis' script begins the action."""
    first, stop = _contact(trial, plan)
    at_s = plan.facts.action_at_s or ACTION_S
    return bool(trial.t_s[first] < at_s < trial.t_s[stop - 1])


def _empty_hand(trial: Trial, plan: ImportMap) -> np.ndarray:
    """[T] the labels of a trial of which only the time of its contact is seen."""
    first, stop = _contact(trial, plan)
    labels = np.full(len(trial.t_s), SITUATIONS.index("nothing"), dtype=np.int8)
    labels[first:stop] = NO_LABEL
    return labels


def _action_of(kinds: set[str]) -> str:
    """The action of a trial of which only situations are known; "" where none is."""
    if {"safe_slip", "risky_slip"} <= kinds:
        return "daily"
    of_kind = {"risky_slip": "slip", "safe_slip": "pass", "grasp": "hold"}
    named = [action for kind, action in of_kind.items() if kind in kinds]
    return named[0] if named else EMPTY_HAND if kinds else ""


# -- files of one trial


def files_of(places: Sequence[LogPlace], fingers: Sequence[str]) -> Files:
    """The files of each log: one, or one for each finger in the order of `fingers`."""
    files: Files = {}
    for word in fingers or ("",):
        for place in places:
            if word in place.name:
                files.setdefault(without(place.name, word), []).append(place)
    return files


def without(name: str, word: str) -> str:
    """A name without the word of a finger."""
    parts = [part.strip("_-. /") for part in name.split(word)] if word else [name]
    return "_".join(filter(None, parts)) or "log"


def read_joined(
    places: Sequence[LogPlace], fingers: Sequence[str], name: str
) -> ForeignLog:
    """One log of one file, or of a file for each finger: then its columns are `finger.column`."""
    if not fingers:
        return read_log(places[0])
    streams = []
    for word, place in zip(fingers, places, strict=True):
        columns = dict(first_stream(read_log(place)).columns)
        time = find_time(columns)
        if time is None:
            raise TimeError("no column of time to join files by", where=place.path)
        stamps = columns.pop(time.time.column).astype(np.float64)
        t_ns = np.round(stamps * time.time.unit_ns).astype(np.int64)
        named = {f"{word}.{key}": column for key, column in columns.items()}
        streams.append(Stream(named, t_ns, word))
    return ForeignLog(places[0].path, name, tuple(streams))


# -- names and labels of a trial


def names_of(log: ForeignLog, rows: Rows, plan: ImportMap) -> dict[str, str]:
    """Person, object and action of a trial: by the path, by columns, by what is always so.

    Raises LabelError.
    """
    names = {}
    of_path = plan.trials.names_of(log.name, log.path)
    for key in NAMES:
        fact = getattr(plan.facts, key) or log.about.get(key) or ""
        names[key] = str(of_path.get(key, fact))
        column = rows.cells.get(getattr(plan.trials, key))
        if column is not None:
            of_trial = [cell for cell in dict.fromkeys(column) if cell]
            if len(of_trial) > 1:
                raise LabelError(
                    f"several values of trials.{key} in one trial: {listed(of_trial)}",
                    where=log.path,
                    next_step="split the log there: [trials] column",
                )
            names[key] = (of_trial or [names[key]])[0]
    word = names["action"]
    action = plan.action(word) if word else ""
    if action is None:
        raise LabelError(
            f"the word {word!r:.60} is no action",
            where=log.path,
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


def labels_of_rows(
    log: ForeignLog, rows: Rows, trial: Trial, plan: ImportMap, events: Sequence[Event]
) -> tuple[np.ndarray, int]:
    """([T] the situation of each row of a trial, -1 for none; how many events it has).

    Raises LabelError.
    """
    labels = np.full(len(trial.t_s), NO_LABEL, dtype=np.int8)
    rules = plan.events
    if rules is None:
        return labels, 0
    begin = float(rows.stamps[-1]) - 1e9 * float(trial.t_s[-1])
    n_used = 0
    # what lasts shorter lies within what lasts longer
    for event in sorted(
        _events(log, rows, plan, events), key=lambda one: one.start - one.end
    ):
        ends_s = 1e-9 * (np.array([event.start, event.end]) - begin) - 1e-6
        first, stop = np.searchsorted(trial.t_s, ends_s)
        situation = plan.situation(event.label)
        if situation is None and event.label and stop > first:
            raise LabelError(
                f"the label {event.label!r:.60} is no situation",
                where=log.path,
                next_step=f'--action "{event.label:.60}=slip" (or hold, pass, ..)',
            )
        if situation and stop > first:
            n_used += ends_s[0] > -0.01
            labels[first:stop] = SITUATIONS.index(situation)
    if rules.rest:
        first, stop = _contact(trial, plan)
        within = labels[first:stop]
        within[within == NO_LABEL] = SITUATIONS.index(rules.rest)
        # a mark without an end lasts to that of the contact
        if rules.hold:
            labels[stop:] = NO_LABEL
    return labels, n_used


def _events(
    log: ForeignLog, rows: Rows, plan: ImportMap, events: Sequence[Event]
) -> list[Event]:
    """The events of a trial, ns on the clock of its rows; events: those of its table."""
    rules = plan.events
    assert rules is not None
    if rules.column in rows.cells:
        cells = rows.cells[rules.column].tolist()
        if rules.hold:
            # the value of most rows says that nothing begins there
            usual, _ = Counter(cells).most_common(1)[0]
            off = {usual} - rules.labels.keys()
            cells = held(["" if cell in off else cell for cell in cells])
        return runs_of(cells, rows.stamps)
    keys = {"", *log.keys, *map(str.casefold, rows.cells.get(plan.trials.column, []))}
    zero_ns = 0 if rules.zero == "clock" else int(rows.stamps[0])
    ours = []
    for event in events:
        if event.trial.casefold() in keys:
            ours.append(in_ns(event, rules, rows.stamps, zero_ns))
    return ours
