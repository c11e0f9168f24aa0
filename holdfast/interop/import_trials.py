"""Logs become trials by a map: cut, named, labelled and checked, before anything is written.

A fault is noted with the line of the map that it hangs on, and the reading goes on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path

import numpy as np

from holdfast.core.column_map import ColumnMap
from holdfast.core.contract import FloatArray, IntArray, channel_names
from holdfast.core.errors import (
    ColumnError,
    DataError,
    DataNotFound,
    EmptyRecording,
    LabelError,
    TimeError,
)
from holdfast.core.trial_file import (
    TIME_COLUMN,
    Trial,
    implausible_rate,
    trial_of,
)
from holdfast.interop.events import (
    FOR_EVER_NS,
    Event,
    EventTables,
    at_event,
    events_in_ns,
    events_of_column,
    matching,
)
from holdfast.interop.import_map import ACTIONS, NAMES, ImportMap
from holdfast.interop.logs.find import LogPlace, find_logs, read_log
from holdfast.interop.logs.log import Columns, ForeignLog, text_cells
from holdfast.training.datasets.thesis import prepared
from holdfast.training.datasets.trials import EMPTY_HAND
from holdfast.training.progress import Part, ignored
from holdfast.training.timeline import LABELLED_ACTIONS, UNSCRIPTED, contact

PROVENANCE = "events"
"""What a truth file says of where its phases come from."""
DAILY = "daily"
"""The action of a trial of which only events are known."""
MOST_TRIALS = 100_000


@dataclass(frozen=True)
class ImportFault:
    """What keeps a log from being imported. map_line: of the map, with its text; "" for none."""

    where: str
    what: str
    next_step: str
    map_line: str


@dataclass(frozen=True)
class Phase:
    """[t0_s, t1_s) from the first row of a trial, in a situation."""

    t0_s: float
    t1_s: float
    label: str


@dataclass(frozen=True)
class ImportedTrial:
    """A trial to be written. source: the log, and which part of it.

    person: "" where none is known; object_name: "" for the hand alone. phases: None where the
    action labels the trial.
    """

    source: str
    person: str
    object_name: str
    action: str
    trial: Trial
    phases: tuple[Phase, ...] | None


@dataclass(frozen=True)
class _Cut:
    """Rows [first, stop) of a log that are a trial. key: how events name it."""

    first: int
    stop: int
    key: str = ""
    action_word: str = ""


@dataclass(frozen=True)
class _Rows:
    """A log by the map: stamps [T] ns on its clock, values [T, C] in the model's unit."""

    log: ForeignLog
    table: Columns
    stamps: IntArray
    values: FloatArray


class TrialImport:
    """Reads logs by a map and collects trials and faults."""

    def __init__(self, source: Path, plan: ImportMap) -> None:
        self.plan, self.source = plan, source
        self.trials: list[ImportedTrial] = []
        self.faults: list[ImportFault] = []
        rules = plan.events
        self._events = None
        if rules is not None and rules.file:
            self._events = EventTables(rules, source, plan.table)

    def read(self, part: Part = ignored) -> None:
        """All logs of the source. part: receives the share that is read."""
        places = self._places()
        for number, place in enumerate(places, 1):
            with self._noted(place.path):
                self._read_log(place)
            part(number / len(places))

    def _places(self) -> list[LogPlace]:
        """The logs without those that are skipped, and without tables of events."""
        places = []
        for place in find_logs(self.source):
            skipped = any(fnmatch(place.name, one) for one in self.plan.trials.skip)
            if not skipped and place.path != self.plan.columns.path:
                places.append(place)
        tables = set()
        if self._events is not None:
            tables = {self._events.path_of(place) for place in places}
        places = [place for place in places if place.path not in tables]
        if not places:
            raise DataNotFound(
                "no log beside the events", where=self.source, next_step="give the logs"
            )
        return places

    @contextmanager
    def _noted(self, path: Path) -> Iterator[None]:
        """A fault in the block is noted; the reading goes on behind it."""
        try:
            yield
        except DataError as error:
            self.fault(error, path)

    def fault(self, error: DataError, path: Path) -> None:
        """Note a fault."""
        columns = self.plan.columns
        line = _map_line(error, columns)
        cause = f" ({error.cause})" if error.cause else ""
        where = error.where or str(path)
        self.faults.append(
            ImportFault(where, error.what + cause, error.next_step, line)
        )

    def _read_log(self, place: LogPlace) -> None:
        log = read_log(place, self.plan.table)
        rows = _by_map(log, self.plan)
        cuts = list(self._cuts(rows, place))
        if not cuts:
            raise EmptyRecording(
                f"no trial in it, by = {self.plan.trials.by!r}", where=place.path
            )
        for number, cut in enumerate(cuts, 1):
            source = place.name if len(cuts) == 1 else f"{place.name} (trial {number})"
            part = len(cuts) > 1 or self.plan.trials.by != "file"
            where = Path(f"{place.path}, trial {number}") if part else place.path
            with self._noted(where):
                self._trial(rows, cut, place, source, where)

    # -- where a trial ends

    def _cuts(self, rows: _Rows, place: LogPlace) -> Iterator[_Cut]:
        rules, n_rows = self.plan.trials, len(rows.stamps)
        if rules.by == "file":
            yield _Cut(0, n_rows)
        elif rules.by == "gaps":
            steps = np.diff(rows.stamps)
            ends = np.flatnonzero(steps > 1e9 * rules.gap_s) + 1
            bounds = [0, *ends.tolist(), n_rows]
            for first, stop in pairwise(bounds):
                yield _Cut(first, stop)
        elif rules.by == "column":
            yield from self._cuts_of_column(rows, place)
        else:
            yield from self._cuts_of_events(rows, place)

    def _cuts_of_column(self, rows: _Rows, place: LogPlace) -> Iterator[_Cut]:
        name = self.plan.trials.column
        cells = _texts(rows.table, name, "trials.column", place.path)
        starts = [k for k, cell in enumerate(cells) if not k or cell != cells[k - 1]]
        for first, stop in zip(starts, [*starts[1:], len(cells)], strict=True):
            # rows between trials have no name
            if cells[first]:
                yield _Cut(first, stop, cells[first])

    def _cuts_of_events(self, rows: _Rows, place: LogPlace) -> Iterator[_Cut]:
        """A trial for each event whose label is an action."""
        for event in self._events_of(rows, place, _Cut(0, len(rows.stamps))):
            if self.plan.action(event.label) is not None:
                first, stop = np.searchsorted(rows.stamps, [event.start, event.end])
                yield _Cut(int(first), int(stop), event.label, event.label)

    def _events_of(self, rows: _Rows, place: LogPlace, cut: _Cut) -> list[Event]:
        """The events of a trial, ns on the log's clock."""
        rules = self.plan.events
        if rules is None:
            return []
        if self._events is None:
            within = slice(cut.first, cut.stop)
            return events_of_column(
                rows.log, rules.column, rows.table, rows.stamps, within
            )
        keys = [place.name, place.path.name, place.path.stem, Path(place.name).name]
        by_trial = [cut.key] if self.plan.trials.by == "column" else keys
        events = matching(self._events.of(place), [*by_trial, *keys])
        in_trial = rules.zero == "trial"
        stamps = rows.stamps[cut.first : cut.stop] if in_trial else rows.stamps
        zero_ns = 0 if rules.zero == "clock" else int(stamps[0])
        return events_in_ns(events, rules, stamps, zero_ns)

    # -- one trial

    def _trial(
        self, rows: _Rows, cut: _Cut, place: LogPlace, source: str, where: Path
    ) -> None:
        names = self._names(rows, cut, place, where)
        trial = _checked(rows, cut, self.plan.columns, where)
        action = names["action"]
        events = self._events_of(rows, place, cut)
        phases = self._phases(rows, cut, events, trial, place) if events else ()
        if not action and phases:
            action = DAILY
        if not action:
            raise LabelError(
                "no action is known of the trial",
                where=where,
                next_step="write facts.action, trials.action or {action} in trials.path: "
                f"one of {', '.join(ACTIONS)}; or give its [events]",
            )
        if action in UNSCRIPTED and action not in LABELLED_ACTIONS and not phases:
            raise LabelError(
                f"a {action!r} needs its events, and there is none in the trial",
                where=where,
                next_step="correct [events], or leave it out: [trials] skip",
            )
        is_alone = action == EMPTY_HAND
        self.trials.append(
            ImportedTrial(
                source=source,
                person=names["person"],
                object_name="" if is_alone else names["object"] or "object",
                action=action,
                trial=trial,
                phases=None if is_alone or not phases else phases,
            )
        )

    def _names(
        self, rows: _Rows, cut: _Cut, place: LogPlace, where: Path
    ) -> dict[str, str]:
        """Person, object and action of a trial: by the path, by columns, by what is always so."""
        plan = self.plan
        about = rows.log.about
        names = {key: str(plan.facts.get(key) or about.get(key) or "") for key in NAMES}
        names |= _names_of_path(plan.trials.path, place)
        for key, column in plan.trials.columns.items():
            cells = _texts(rows.table, column, f"trials.{key}", place.path)
            of_trial = dict.fromkeys(
                cell for cell in cells[cut.first : cut.stop] if cell
            )
            if len(of_trial) > 1:
                raise LabelError(
                    f"column {column} (trials.{key}) has several values in one trial: "
                    f"{', '.join(list(of_trial)[:4])}",
                    where=where,
                    next_step='split the log there: [trials] by = "column"',
                )
            names[key] = next(iter(of_trial), names[key])
        word = cut.action_word or names["action"]
        known = plan.action(word) if word else ""
        if known is None:
            raise LabelError(
                f"the word {word!r:.60} is no action (actions)",
                where=where,
                next_step=f'add "{word:.60}" = .. to [actions] of the map, one of '
                f"{', '.join(ACTIONS)}",
            )
        return {key: safe_name(value) for key, value in names.items()} | {
            "action": known
        }

    def _phases(
        self,
        rows: _Rows,
        cut: _Cut,
        events: Sequence[Event],
        trial: Trial,
        place: LogPlace,
    ) -> tuple[Phase, ...]:
        """The phases of a trial by its events, and what a closed hand does outside them."""
        rules = self.plan.events
        assert rules is not None
        path = self._events.path_of(place) if self._events else place.path
        begin = int(rows.stamps[cut.first])
        lasts_s = float(trial.t_s[-1]) + 1.0 / trial.rate_hz
        phases: list[Phase] = []
        for event in events:
            t0_s = max(0.0, 1e-9 * (event.start - begin))
            t1_s = min(lasts_s, 1e-9 * (min(event.end, FOR_EVER_NS) - begin))
            if t1_s <= t0_s or (
                self.plan.trials.by == "events" and event.label == cut.key
            ):
                continue
            situation = rules.situation or self.plan.situation(event.label)
            if situation is None:
                unknown = LabelError(
                    f"the label {event.label!r:.60} is no situation (events.labels)",
                    next_step=f'add "{event.label:.60}" = .. to [events.labels] of the map: a '
                    'situation, or "" for none',
                )
                raise at_event(unknown, path, event)
            if situation and phases and phases[-1].t1_s > t0_s + 1e-9:
                overlap = LabelError(
                    f"{event.label!r:.60} begins at {t0_s:.3f} s, before the event above ends",
                    next_step='correct one of them, or map one label to ""',
                )
                raise at_event(overlap, path, event)
            if situation:
                phases.append(Phase(t0_s, t1_s, situation))
        if rules.rest and phases:
            phases = _with_rest(phases, trial, rules.rest, self.plan.columns)
        return tuple(phases)


def _with_rest(
    phases: Sequence[Phase], trial: Trial, rest: str, columns: ColumnMap
) -> list[Phase]:
    """The phases, and `rest` between them while the hand is closed on something."""
    samples = prepared(trial, columns.unit_of_values, "").samples
    first, stop = contact(trial.t_s, samples)
    at_s, end_s = (
        float(trial.t_s[first]),
        float(trial.t_s[stop - 1]) + 1 / trial.rate_hz,
    )
    whole: list[Phase] = []
    for phase in phases:
        if phase.t0_s > at_s:
            whole.append(Phase(at_s, min(phase.t0_s, end_s), rest))
        whole.append(phase)
        at_s = max(at_s, phase.t1_s)
    if at_s < end_s:
        whole.append(Phase(at_s, end_s, rest))
    return [phase for phase in whole if phase.t1_s > phase.t0_s]


def _by_map(log: ForeignLog, plan: ImportMap) -> _Rows:
    """The samples of a log. Raises ColumnError or NotANumber."""
    columns, rules = plan.columns, plan.trials
    wanted = {*columns.columns, *rules.columns.values()}
    if rules.by == "column":
        wanted.add(rules.column)
    # labels of a topic of their own are not joined to the samples
    if plan.events is not None and plan.events.column and not log.stamped:
        wanted.add(plan.events.column)
    table = log.table(wanted)
    values = columns.values_of(table, log.path)
    stamps = columns.stamps_ns(table, len(values), log.path)
    return _Rows(log, table, stamps, values)


def _checked(rows: _Rows, cut: _Cut, columns: ColumnMap, where: Path) -> Trial:
    """The trial of a cut, checked as a file of its own is. Raises EmptyRecording or TimeError."""
    stamps = rows.stamps[cut.first : cut.stop]
    if not len(stamps):
        raise EmptyRecording("no row of the log lies in it", where=where)
    t_s = 1e-9 * (stamps - stamps[0])
    values = np.where(np.isfinite(rows.values), rows.values, np.nan)
    table = np.column_stack([t_s, values[cut.first : cut.stop]])
    header = [TIME_COLUMN, *channel_names(len(columns.sensors))]
    at = rows.log.first_line + cut.first
    _require_time(t_s, columns, where)
    return trial_of(header, table, where, lambda row: f"row {at + row}")


def _require_time(t_s: FloatArray, columns: ColumnMap, where: Path) -> None:
    """Raise TimeError where a time without a unit is none in seconds, by what it looks like."""
    if columns.time.unit is not None or columns.time.rate_hz is not None:
        return
    steps = np.diff(t_s)
    if not len(steps) or not np.median(steps) > 0.0:
        return
    wrong = implausible_rate(1.0 / float(np.median(steps)), float(t_s[-1]))
    if wrong:
        raise TimeError(
            f"{wrong}; the map gives time.unit of no column",
            where=where,
            next_step='write unit = "ms" (or s, us, ns) to [time] of the map',
        )


def _texts(table: Columns, name: str, key: str, path: Path) -> list[str]:
    """The cells of a column that the map names. Raises ColumnError."""
    if name not in table:
        raise ColumnError(
            f"no column {name} ({key})", where=path, next_step="correct the column map"
        )
    return text_cells(table[name])


def path_pattern(path: str) -> re.Pattern[str]:
    """A pattern such as `{person}/{object}_{trial}` as a regular expression; * is any text."""
    parts = re.split(r"(\{\w+\}|\*)", path)
    found = []
    for part in parts:
        if part == "*":
            found.append("[^/]*")
        elif part.startswith("{") and part.endswith("}"):
            found.append(f"(?P<{part[1:-1]}>[^/]+?)")
        else:
            found.append(re.escape(part))
    return re.compile("".join(found))


def _names_of_path(path: str, place: LogPlace) -> dict[str, str]:
    """What the log's path says by the pattern. Raises LabelError."""
    if not path:
        return {}
    match = path_pattern(path).fullmatch(place.name)
    if match is None:
        raise LabelError(
            f"{place.name} is not {path} (trials.path)",
            where=place.path,
            next_step="correct trials.path in the column map, or leave it out: [trials] skip",
        )
    return {key: text for key, text in match.groupdict().items() if key in NAMES}


def safe_name(text: str) -> str:
    """A name as a folder: letters, digits and dashes.

    >>> safe_name("Soft ball #2")
    'Soft-ball-2'
    """
    plain = re.sub(r"[^\w-]+", "-", text.strip(), flags=re.ASCII)
    return plain.strip("-_")[:60]


KEY_IN_TEXT = re.compile(
    r"\b((?:time|trials|events|facts|table)\.\w+|sensors\[\d+\](?:\.\w)?|actions)\b"
)
"""A key of the map in the text of an error."""


def _map_line(error: DataError, columns: ColumnMap) -> str:
    """The line of the map that an error hangs on, with its text."""
    text = f"{error.what} {error.next_step}"
    match = KEY_IN_TEXT.search(text)
    number = re.search(r"\(line (\d+)\)", error.what)
    if number:
        place = f"line {number[1]}"
    elif match:
        place = columns.place_of(match[1])
    elif isinstance(error, TimeError):
        place = columns.place_of("time.column")
    else:
        return ""
    if not place.startswith("line "):
        return ""
    at = int(place.removeprefix("line "))
    return f"line {at}: {columns.text.split(chr(10))[at - 1].strip()}"
