"""Logs become trials by a map: cut, named, labelled and checked, before anything is written.

A fault is noted with the line of the map that it hangs on, and the reading goes on.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from fnmatch import fnmatch
from itertools import pairwise
from pathlib import Path

import numpy as np

from holdfast.core.column_map import ColumnMap
from holdfast.core.errors import (
    DataError,
    DataNotFound,
    EmptyRecording,
    LabelError,
    TimeError,
)
from holdfast.core.trial_file import (
    Trial,
)
from holdfast.core.trial_layout import LABELLED_ACTIONS, UNSCRIPTED
from holdfast.interop.events import (
    Event,
    EventTables,
    at_event,
    events_of_column,
    matching,
)
from holdfast.interop.import_map import (
    ACTIONS,
    NAMES,
    ImportMap,
    names_of_path,
    safe_name,
)
from holdfast.interop.import_rows import (
    Cut,
    LogRows,
    Phase,
    by_map,
    checked,
    phases_of,
    texts_of,
)
from holdfast.interop.logs.find import LogPlace, find_logs, read_log
from holdfast.training.datasets.trials import EMPTY_HAND
from holdfast.training.progress import Part, ignored

PROVENANCE = "events"
"""What a truth file says of where its phases come from."""
DAILY = "daily"
"""The action of a trial of which only events are known."""


@dataclass(frozen=True)
class ImportFault:
    """What keeps a log from being imported. map_line: of the map, with its text; "" for none."""

    where: str
    what: str
    next_step: str
    map_line: str


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


class TrialImport:
    """Reads logs by a map and collects trials and faults."""

    def __init__(self, source: Path, plan: ImportMap) -> None:
        self.plan, self.source = plan, source
        self.trials: list[ImportedTrial] = []
        self.faults: list[ImportFault] = []
        self.notes: list[str] = []
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
        for path, event in self._events.strangers() if self._events else []:
            stranger = LabelError(
                f"{event.trial!r:.60} is no log and no trial (events.trial)",
                next_step="correct its name, or remove its lines",
            )
            self.fault(at_event(stranger, path, event), path)
        if self._events is not None:
            self._note_missed(self._events)

    def _note_missed(self, tables: EventTables) -> None:
        """Events outside their log are faults; so are those that label no row, if none does."""
        is_whole = not self.faults
        for path, event, why in tables.outside():
            lost = f"{event.label!r:.60} at {event.start:g} {tables.rules.unit} is in no trial"
            missed = LabelError(
                why or f"{lost} of its log, and no other event is",
                next_step="correct [events], or remove that line",
            )
            if why or (is_whole and not tables.labels_rows(path)):
                self.fault(at_event(missed, path, event), path)
            else:
                self.notes.append(f"{path}, line {event.line}: {lost}: left out")

    def _places(self) -> list[LogPlace]:
        """The logs without those that are skipped, and without tables of events."""
        places = []
        for place in find_logs(self.source):
            if self._events is not None:
                self._events.know(_keys_of(place))
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
        rows = by_map(log, self.plan)
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

    def _cuts(self, rows: LogRows, place: LogPlace) -> Iterator[Cut]:
        rules, n_rows = self.plan.trials, len(rows.stamps)
        if rules.by == "file":
            yield Cut(0, n_rows)
        elif rules.by == "gaps":
            steps = np.diff(rows.stamps)
            ends = np.flatnonzero(steps > 1e9 * rules.gap_s) + 1
            bounds = [0, *ends.tolist(), n_rows]
            for first, stop in pairwise(bounds):
                yield Cut(first, stop)
        elif rules.by == "column":
            yield from self._cuts_of_column(rows, place)
        else:
            yield from self._cuts_of_events(rows, place)

    def _cuts_of_column(self, rows: LogRows, place: LogPlace) -> Iterator[Cut]:
        name = self.plan.trials.column
        cells = texts_of(rows.table, name, "trials.column", place.path)
        starts = [k for k, cell in enumerate(cells) if not k or cell != cells[k - 1]]
        for first, stop in zip(starts, [*starts[1:], len(cells)], strict=True):
            # rows between trials have no name
            if cells[first]:
                yield Cut(first, stop, cells[first])

    def _cuts_of_events(self, rows: LogRows, place: LogPlace) -> Iterator[Cut]:
        """A trial for each event whose label is an action."""
        for event in self._events_of(rows, place, Cut(0, 0)):
            if self.plan.action(event.label) is not None:
                first, stop = np.searchsorted(rows.stamps, [event.start, event.end])
                yield Cut(int(first), int(stop), event.label, event.label)

    def _events_of(self, rows: LogRows, place: LogPlace, cut: Cut) -> list[Event]:
        """The events of a trial, ns on the log's clock."""
        rules = self.plan.events
        if rules is None:
            return []
        if self._events is None:
            within = slice(cut.first, cut.stop)
            return events_of_column(
                rows.log, rules.column, rows.table, rows.stamps, within
            )
        keys = _keys_of(place)
        by_trial = [cut.key] if self.plan.trials.by == "column" else keys
        self._events.know(by_trial)
        events = matching(self._events.of(place), [*by_trial, *keys])
        in_trial = rows.stamps[cut.first : cut.stop]
        is_of_trial = rules.zero == "trial" and len(in_trial)
        stamps = in_trial if is_of_trial else rows.stamps
        zero_ns = 0 if rules.zero == "clock" else int(stamps[0])
        path = self._events.path_of(place)
        return self._events.in_ns(path, events, stamps, zero_ns, in_trial)

    # -- one trial

    def _trial(
        self, rows: LogRows, cut: Cut, place: LogPlace, source: str, where: Path
    ) -> None:
        names = self._names(rows, cut, place, where)
        trial = checked(rows, cut, self.plan.columns, where)
        action = names["action"]
        events = self._events_of(rows, place, cut)
        phases: tuple[Phase, ...] = ()
        # a trial named for a slip that has no row keeps the labels of its name: it is no grasp
        rests = self.plan.events is not None and self.plan.events.rest
        if events or (rests and action in ("", "hold", DAILY)):
            begin = int(rows.stamps[cut.first])
            skipped = cut.key if self.plan.trials.by == "events" else ""
            path = self._events.path_of(place) if self._events else place.path
            phases = phases_of(self.plan, events, trial, begin, skipped, path)
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
        self, rows: LogRows, cut: Cut, place: LogPlace, where: Path
    ) -> dict[str, str]:
        """Person, object and action of a trial: by the path, by columns, by what is always so."""
        plan = self.plan
        about = rows.log.about
        names = {key: str(plan.facts.get(key) or about.get(key) or "") for key in NAMES}
        names |= names_of_path(plan.trials.path, place.name, place.path)
        for key, column in plan.trials.columns.items():
            cells = texts_of(rows.table, column, f"trials.{key}", place.path)
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


def _keys_of(place: LogPlace) -> list[str]:
    """How a table of events may name a log."""
    return [place.name, place.path.name, place.path.stem, Path(place.name).name]


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
