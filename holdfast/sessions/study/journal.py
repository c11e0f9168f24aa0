"""study.jsonl: what happened in one person's study, a line each, on the disk before the next step.

Every line has `event`, `run` (how often the program was started), `t_s` (monotonic, from the start
of that run) and `at` (UTC). Where the study goes on is read from these lines alone, so a run that
was killed at any moment loses at most the line that it was writing.
"""

from __future__ import annotations

import errno
import fcntl
import json
import os
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field
from enum import StrEnum
from pathlib import Path
from typing import Any

from holdfast.core.contract import Json
from holdfast.core.errors import LabelError, OutputError
from holdfast.core.tactile_file import repair_lines
from holdfast.core.trial_layout import read_events
from holdfast.sessions.recorder.folder import is_json_object

JOURNAL = "study.jsonl"
"""In the person's folder."""


class Event(StrEnum):
    """What a line says has happened; the values stand in the file."""

    OPENED = "opened"
    BEGUN = "begun"
    DONE = "done"
    SKIPPED = "skipped"
    BACK = "back"
    PAUSED = "paused"
    RESUMED = "resumed"
    QUIT = "quit"
    FINISHED = "finished"
    NOTE = "note"
    ADVERSE = "adverse"
    DETAIL = "adverse_detail"
    FAILED = "failed"


MOVES = (Event.DONE, Event.SKIPPED, Event.BACK)
"""They name the next part."""
STARTS_TIME = (Event.BEGUN, Event.RESUMED)
"""After one of these the part under way takes time."""
STOPS_TIME = (*MOVES, Event.PAUSED, Event.QUIT)
"""After one of these it takes none."""


@dataclass
class Progress:
    """Where a study stands. part: the number of the part to do or under way, from 0.

    begun: it is under way. kept_before: part -> trials of its task that were kept when it first
    began. spent_s: part -> time in it.
    """

    part: int = 0
    begun: bool = False
    kept_before: dict[int, int] = field(default_factory=dict)
    spent_s: dict[int, float] = field(default_factory=dict)
    finished: bool = False
    runs: int = 0
    _since_s: float | None = None
    _last_s: float = 0.0

    def take(self, entry: Json) -> None:
        """One more line. Raises KeyError, TypeError or ValueError where it is no entry."""
        event = entry["event"]
        t_s = float(entry["t_s"])
        # A line without a date is refused, although nothing here is computed from it.
        _ = entry["at"]

        if event == Event.OPENED:
            # A run that was killed wrote no end: its time counts up to its last line.
            self._stop(self._last_s)
            self.runs += 1
            self.finished = False
        elif event == Event.BEGUN:
            self.part = int(entry["part"])
            self.begun = True
            # Of its first beginning: a step that is begun again has its trials already.
            self.kept_before.setdefault(self.part, int(entry.get("kept", 0)))
        elif event in (Event.NOTE, Event.DETAIL):
            # Checked here, so that a report never meets an entry without its text.
            str(entry["text"])
        elif event == Event.FINISHED:
            self.finished = True

        if event in STOPS_TIME:
            self._stop(t_s)
        elif event in STARTS_TIME and self.begun and self._since_s is None:
            self._since_s = t_s

        if event in MOVES:
            self.part = int(entry["next"])
            self.begun = False

        self._last_s = t_s

    def spent_until(self, t_s: float) -> float:
        """Time in the part under way, s, pauses left out."""
        # A pause, or a part that is not begun, takes no time.
        now_s = 0.0 if self._since_s is None else t_s - self._since_s
        return self.spent_s.get(self.part, 0.0) + now_s

    def _stop(self, t_s: float) -> None:
        """The part under way takes no more time."""
        if self._since_s is not None:
            self.spent_s[self.part] = self.spent_until(t_s)
        self._since_s = None


class Journal:
    """The open journal of one person; utc: the time now as text."""

    def __init__(
        self,
        path: Path,
        n_parts: int,
        now_ns: Callable[[], int],
        utc: Callable[[], str],
    ) -> None:
        self.path = path
        self._now_ns = now_ns
        self._utc = utc
        self.entries = read_events(path)
        # Read back from the file alone: nothing else says where the study stands.
        self.progress = progress_of(self.entries, path, n_parts)
        self._began_ns = now_ns()

    @property
    def t_s(self) -> float:
        """Time since this run began, s."""
        return 1e-9 * (self._now_ns() - self._began_ns)

    @property
    def part(self) -> int:
        """The number of the part to do or under way."""
        return self.progress.part

    @property
    def spent_s(self) -> float:
        """Time in the part under way, s."""
        return self.progress.spent_until(self.t_s)

    def append(self, event: Event, **more: Any) -> None:
        """Write a line and bring it to the disk. Raises OutputError."""
        entry = {
            "event": event,
            "run": self.progress.runs + (event == Event.OPENED),
            "t_s": round(self.t_s, 3),
            "at": self._utc(),
            **more,
        }
        line = (json.dumps(entry, allow_nan=False) + "\n").encode()

        try:
            # Opened anew for each line: after a full disk the next line is tried afresh.
            handle = os.open(self.path, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
            try:
                # One write a line, so that a kill leaves whole lines; a short one means a full
                # disk.
                if os.write(handle, line) < len(line):
                    raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
                # The next step begins only when this line is on the disk.
                os.fsync(handle)
            finally:
                os.close(handle)
        except OSError as error:
            raise OutputError(
                f"cannot write ({error.strerror})",
                where=self.path,
                cause="a full disk, or no permission",
                next_step="make room and run the same command again; it goes on here",
            ) from None

        # Only what is on the disk counts as having happened.
        self.entries.append(entry)
        self.progress.take(entry)


@contextmanager
def opened_journal(
    home: Path, n_parts: int, now_ns: Callable[[], int], utc: Callable[[], str]
) -> Iterator[Journal]:
    """The journal of a person's folder, new or repaired, for one program at a time.

    n_parts: of the protocol. Raises OutputError (another terminal has it), LabelError (a line that
    cannot be read).
    """
    home.mkdir(parents=True, exist_ok=True)
    path = home / JOURNAL
    with held(path):
        # A line that a kill tore is moved aside before the file is read.
        repair_lines(path, is_json_object)
        yield Journal(path, n_parts, now_ns, utc)


@contextmanager
def held(path: Path) -> Iterator[None]:
    """No other program has the journal meanwhile. Raises OutputError."""
    # Opening to append makes the file where there is none, and changes nothing else.
    with path.open("ab") as file:
        try:
            fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OutputError(
                "another program runs this person's study",
                where=path,
                cause="a second terminal",
                next_step="go on there, or end that program first",
            ) from None
        yield


def progress_of(entries: list[Json], path: Path, n_parts: int) -> Progress:
    """Where the lines leave the study of a protocol with so many parts. Raises LabelError."""
    progress = Progress()
    for number, entry in enumerate(entries, 1):
        try:
            progress.take(entry)
            # The last part done leaves the study at n_parts, which no entry may name.
            known = 0 <= entry.get("part", 0) < n_parts
            if not known or not 0 <= progress.part <= n_parts:
                raise ValueError("the protocol has no such part")
        except (KeyError, TypeError, ValueError, OverflowError) as error:
            raise LabelError(
                f"line {number} is no entry of a study ({error!r:.60})",
                where=path,
                cause="it was edited, or it is another file",
                next_step="correct that line, or take another --out",
            ) from None

    return progress
