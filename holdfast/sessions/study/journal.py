"""study.jsonl: what happened in one person's study, a line each, on the disk before the next step.

Every line has `event`, `run` (how often the program was started), `t_s` (monotonic, from the start
of that run) and `at` (UTC). Where the study goes on is read from these lines alone, so a run that
was killed at any moment loses at most the line that it was writing.

Withdrawal: everything of a person is deleted; which files these were is written down before and
after, in withdrawn.jsonl beside the people's folders, which holds nothing that was recorded.
"""

from __future__ import annotations

import errno
import json
import os
import shutil
import time
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

import msgspec

from holdfast.core.errors import LabelError, OutputError, UsageError, count_of
from holdfast.core.schema import checked
from holdfast.core.tactile_file import TORN, repair_lines
from holdfast.core.trial_layout import read_events
from holdfast.sessions.recorder.folder import folder_lock, is_json_object, written

JOURNAL = "study.jsonl"
"""In the person's folder."""
WITHDRAWN = "withdrawn.jsonl"
"""In the folder of the study, outside every person's."""
NOT_HERE = (
    "not deleted, because they are not here: copies and backups of these files, models trained "
    "with them (train again), and the list of names on paper"
)


class Event(StrEnum):
    """What a line says has happened; the values stand in the file."""

    OPENED = "opened"
    BEGUN = "begun"
    DONE = "done"
    SKIPPED = "skipped"
    BACK = "back"
    QUIT = "quit"
    FINISHED = "finished"
    NOTE = "note"
    ADVERSE = "adverse"
    DETAIL = "adverse_detail"
    FAILED = "failed"


STATES = {Event.BEGUN: "under way", Event.DONE: "done", Event.SKIPPED: "skipped"}
"""What the last of these lines says of a part."""
MOVES = (Event.DONE, Event.SKIPPED, Event.BACK)
"""They name the next part."""
STOPS_TIME = (*MOVES, Event.QUIT)
"""After one of these the part under way takes no time."""


class Entry(msgspec.Struct, frozen=True, omit_defaults=True):
    """A line of the journal. part, next: numbers of parts from 0, -1 where the event has none.

    kept: trials of the part's task that were kept before it began. text, severity: of a note or an
    adverse event. card, sha256, rehearsal: of the protocol, and whether no person took part.
    """

    event: str
    run: int
    t_s: float
    at: str
    part: int = -1
    next: int = -1
    step: int | None = None
    title: str = ""
    kept: int = 0
    text: str = ""
    severity: str | None = None
    error: str = ""
    card: str = ""
    sha256: str = ""
    rehearsal: bool = False


@dataclass
class Progress:
    """Where a study stands. part: the number of the part to do or under way, from 0.

    states: part -> what its last line says. begun: part -> how often. spent_s: part -> time in it.
    kept_before: part -> trials of its task that were kept when it first began.
    """

    part: int = 0
    states: dict[int, str] = field(default_factory=dict)
    begun: Counter[int] = field(default_factory=Counter)
    kept_before: dict[int, int] = field(default_factory=dict)
    spent_s: dict[int, float] = field(default_factory=dict)
    finished: bool = False
    runs: int = 0
    _since_s: float | None = None
    _last_s: float = 0.0

    def take(self, entry: Entry) -> None:
        """Bring the state up to one more entry."""
        event = entry.event
        if event == Event.OPENED:
            # A run that was killed wrote no end: its time counts up to its last line.
            self._stop(self._last_s)
            self.runs += 1
            self.finished = False
        elif event == Event.BEGUN:
            self.part = entry.part
            self._since_s = entry.t_s
            # Of its first beginning: a step that is begun again has its trials already.
            self.kept_before.setdefault(self.part, entry.kept)
        elif event == Event.FINISHED:
            self.finished = True

        if event in STATES:
            # A part may be begun again: its last line counts.
            self.states[entry.part] = STATES[Event(event)]
            self.begun[entry.part] += event == Event.BEGUN
        if event in STOPS_TIME:
            self._stop(entry.t_s)
        if event in MOVES:
            self.part = entry.next
        self._last_s = entry.t_s

    def spent_until(self, t_s: float) -> float:
        """Time in the part under way, s."""
        # A part that is not begun takes no time.
        now_s = 0.0 if self._since_s is None else t_s - self._since_s
        return self.spent_s.get(self.part, 0.0) + now_s

    def _stop(self, t_s: float) -> None:
        """The part under way takes no more time."""
        if self._since_s is not None:
            self.spent_s[self.part] = self.spent_until(t_s)
        self._since_s = None


class Journal:
    """The open journal of one person."""

    def __init__(self, path: Path, now_ns: Callable[[], int]) -> None:
        self.path = path
        self._now_ns = now_ns
        self.entries = read_journal(path)
        # Read back from the file alone: nothing else says where the study stands.
        self.progress = progress_of(self.entries)
        self._began_ns = now_ns()

    @property
    def t_s(self) -> float:
        """Time since this run began, s."""
        return 1e-9 * (self._now_ns() - self._began_ns)

    @property
    def part(self) -> int:
        """The number of the part to do or under way."""
        return self.progress.part

    def append(self, event: Event, **more: Any) -> None:
        """Write a line and bring it to the disk. Raises OutputError."""
        run = self.progress.runs + (event == Event.OPENED)
        entry = Entry(str(event), run, round(self.t_s, 3), utc_now(), **more)
        step = "make room and run the same command again; it goes on here"
        write_line(self.path, msgspec.json.encode(entry), step)
        # Only what is on the disk counts as having happened.
        self.entries.append(entry)
        self.progress.take(entry)


def utc_now() -> str:
    """The time now, UTC, ISO 8601 to the second."""
    return time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime())


def write_line(path: Path, line: bytes, next_step: str) -> None:
    """Append a line to a file, on the disk when this returns. Raises OutputError."""
    with written(path, next_step=next_step):
        # Opened anew for each line: after a full disk the next line is tried afresh.
        handle = os.open(path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            # One write a line, so that a kill leaves whole lines; a short one means a full disk.
            if os.write(handle, line + b"\n") <= len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(handle)
        finally:
            os.close(handle)


def read_journal(path: Path) -> list[Entry]:
    """The lines of a journal, none without a file. Raises LabelError."""
    entries = []
    for number, line in enumerate(read_events(path), 1):
        entries.append(checked(line, Entry, f"{path}: line {number}", LabelError))
    return entries


def torn_lines(home: Path) -> int:
    """How many lines of a person's journal a kill has torn: those moved aside, and the last one."""
    path = home / JOURNAL
    last = path.read_bytes().rpartition(b"\n")[2]
    is_torn = bool(last.strip(b"\0")) and not is_json_object(last)
    return is_torn + len(list(home.glob(f"{JOURNAL}{TORN}*")))


def torn_in_words(count: int) -> str:
    """What is reported of torn lines."""
    return (
        f"warning: {count_of(count, 'torn line')} of the journal left out: "
        "each may be a note or an adverse event"
    )


def opened_journal(home: Path, now_ns: Callable[[], int]) -> Journal:
    """The journal of a person's folder, new or repaired.

    Raises LabelError (a line that cannot be read), OutputError.
    """
    home.mkdir(parents=True, exist_ok=True)
    path = home / JOURNAL
    path.touch()
    # A line that a kill tore is moved aside before the file is read.
    repair_lines(path, is_json_object)
    return Journal(path, now_ns)


def progress_of(entries: list[Entry]) -> Progress:
    """Where the lines leave a study."""
    progress = Progress()
    for entry in entries:
        progress.take(entry)
    return progress


# -- withdrawal


def withdraw(root: Path, person: str, report: Callable[[str], None]) -> None:
    """Delete the folder of a person, and report each file.

    Raises OutputError where a file cannot be deleted, which it names; the others are deleted.
    """
    home = root / person
    again = f"correct that, then run it again with --person {person} --withdraw"

    def note(state: str, names: list[str]) -> None:
        entry = {"event": "withdrawn", "person": person, "state": state}
        line = json.dumps({**entry, "at": utc_now(), "files": names})
        write_line(root / WITHDRAWN, line.encode(), again)

    with folder_lock(root):
        names = _files_in(home)
        # The names are on the disk before the first file goes: what is left could else not be told.
        note("begun", names)
        # One file that cannot be deleted must not keep the others.
        shutil.rmtree(home, ignore_errors=True)
        left = _files_in(home)
        for name in names:
            report(f"not deleted: {name}" if name in left else f"deleted {name}")
        is_whole = not home.exists()
        note("done" if is_whole else "incomplete", left)

    if not is_whole:
        raise OutputError(
            f"cannot be deleted; {len(left)} left of {len(names)} files",
            where=root / (left[0] if left else person),
            cause="no permission, or another program has it",
            next_step=again,
        )
    written = root / WITHDRAWN
    report(
        f"{person} has withdrawn: {len(names)} files deleted; {written} has their names"
    )
    report(NOT_HERE)


def _files_in(home: Path) -> list[str]:
    """Names of all files and links in a person's folder, with the folder's own, sorted."""
    names = []
    for path in home.rglob("*"):
        # A link is deleted itself: what it points to may belong to another person.
        if path.is_symlink() or not path.is_dir():
            names.append(str(path.relative_to(home.parent)))
    return sorted(names)


def require_not_withdrawn(root: Path, person: str) -> None:
    """Raise UsageError for the pseudonym of a person who withdrew."""
    if any(entry.get("person") == person for entry in read_events(root / WITHDRAWN)):
        raise UsageError(
            f"{person} has withdrawn",
            next_step="give a pseudonym that is new; --withdraw deletes what may be left",
        )
