"""Withdrawal: everything of a person is deleted; which files these were is written down.

withdrawn.jsonl beside the people's folders gets a line before the first file is deleted, and one
after the last, so that a deletion that was cut off is seen and done again. It holds paths and
times, nothing that was recorded.
"""

from __future__ import annotations

import json
import os
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path

from holdfast.core.errors import OutputError, UsageError
from holdfast.core.reading import Json
from holdfast.core.trial_layout import read_events
from holdfast.sessions.recorder.folder import alone

WITHDRAWN = "withdrawn.jsonl"
BEGUN, DONE, INCOMPLETE = "begun", "done", "incomplete"
NOT_HERE = (
    "not deleted, because they are not here: copies and backups of these files, models trained "
    "with them (train again), and the list of names on paper"
)


def withdraw(
    root: Path, person: str, say: Callable[[str], None], utc: Callable[[], str]
) -> None:
    """Delete the folder of a person, and say each file.

    Raises OutputError where a file cannot be deleted, which it names; the others are deleted.
    """
    with alone(root):
        home = root / person
        files = sorted(
            path for path in home.rglob("*") if path.is_symlink() or not path.is_dir()
        )
        names = [str(path.relative_to(root)) for path in files]
        _note(root, person, BEGUN, utc, names)
        left: dict[str, str] = {}
        for path, name in zip(files, names, strict=True):
            why = _deleted(path)
            say(f"deleted {name}" if not why else f"not deleted: {name} ({why})")
            left |= {name: why} if why else {}
        for folder in sorted((p for p in home.rglob("*") if p.is_dir()), reverse=True):
            _remove_folder(folder)
        _remove_folder(home)
        if home.exists() and not left:
            left = {person: "something in it cannot be seen or deleted"}
        _note(
            root,
            person,
            INCOMPLETE if left else DONE,
            utc,
            [n for n in names if n not in left],
        )
    if left:
        name, why = next(iter(left.items()))
        raise OutputError(
            f"cannot be deleted ({why}); {len(left)} left of {len(names)} files",
            where=root / name,
            cause="no permission, or another program has it",
            next_step=f"correct that, then run it again with --person {person} --withdraw",
        )
    say(
        f"{person} has withdrawn: {len(names)} files deleted; {root / WITHDRAWN} has their names"
    )
    say(NOT_HERE)


def require_not_withdrawn(root: Path, person: str) -> None:
    """Raise UsageError for the pseudonym of a person who withdrew."""
    states = [
        e["state"] for e in read_events(root / WITHDRAWN) if e.get("person") == person
    ]
    if states and states[-1] == DONE:
        raise UsageError(
            f"{person} has withdrawn", next_step="give a pseudonym that is new"
        )
    if states:
        raise UsageError(
            f"{person} has withdrawn, and the deletion did not end",
            cause="it was cut off, or a file could not be deleted",
            next_step=f"add --withdraw to delete what is left of {person}",
        )


def _deleted(path: Path) -> str:
    """Delete a file; returns why it could not be."""
    try:
        path.unlink()
    except OSError as error:
        return str(error.strerror)
    return ""


def _remove_folder(folder: Path) -> None:
    """Remove a folder if nothing is left in it."""
    with suppress(OSError):
        folder.rmdir()


def _note(
    root: Path, person: str, state: str, utc: Callable[[], str], deleted: list[str]
) -> None:
    """A line of withdrawn.jsonl, on the disk. Raises OutputError."""
    entry: Json = {"event": "withdrawn", "person": person, "state": state, "at": utc()}
    entry |= {"files": deleted} if state == BEGUN else {"deleted": deleted}
    try:
        with (root / WITHDRAWN).open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(entry) + "\n")
            lines.flush()
            os.fsync(lines.fileno())
    except OSError as error:
        raise OutputError(
            f"cannot write ({error.strerror}); {'nothing' if state == BEGUN else 'all'} is deleted",
            where=root / WITHDRAWN,
            cause="a full disk, or no permission",
            next_step="make room, then run it again with --withdraw",
        ) from None
