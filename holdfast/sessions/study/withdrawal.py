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
from holdfast.core.trial_layout import read_events
from holdfast.sessions.recorder.folder import alone

WITHDRAWN = "withdrawn.jsonl"
"""In the folder of the study, outside every person's."""
BEGUN = "begun"
DONE = "done"
INCOMPLETE = "incomplete"
NOT_HERE = (
    "not deleted, because they are not here: copies and backups of these files, models trained "
    "with them (train again), and the list of names on paper"
)


def withdraw(
    root: Path, person: str, report: Callable[[str], None], utc: Callable[[], str]
) -> None:
    """Delete the folder of a person, and report each file.

    Raises OutputError where a file cannot be deleted, which it names; the others are deleted.
    """
    with alone(root):
        left, n_files = _delete_all(root, person, report, utc)

    if left:
        # One file stands for all in the error; every one was reported above.
        name, why = next(iter(left.items()))
        raise OutputError(
            f"cannot be deleted ({why}); {len(left)} left of {n_files} files",
            where=root / name,
            cause="no permission, or another program has it",
            next_step=f"correct that, then run it again with --person {person} --withdraw",
        )

    names = root / WITHDRAWN
    report(f"{person} has withdrawn: {n_files} files deleted; {names} has their names")
    report(NOT_HERE)


def _delete_all(
    root: Path, person: str, report: Callable[[str], None], utc: Callable[[], str]
) -> tuple[dict[str, str], int]:
    """(name of each file that is left -> why, how many files there were)."""
    home = root / person
    files = []
    folders = [home]

    for path in sorted(home.rglob("*")):
        # A link is deleted itself: what it points to may belong to another person.
        if path.is_dir() and not path.is_symlink():
            folders.append(path)
        else:
            files.append(path)

    # The names are on the disk before the first file goes.
    names = [str(path.relative_to(root)) for path in files]
    entry = {"event": "withdrawn", "person": person}
    _note(root, {**entry, "state": BEGUN, "at": utc(), "files": names})

    left: dict[str, str] = {}
    # One file that cannot be deleted must not keep the others.
    for path, name in zip(files, names, strict=True):
        try:
            path.unlink()
            report(f"deleted {name}")
        except OSError as error:
            left[name] = str(error.strerror)
            report(f"not deleted: {name} ({error.strerror})")

    # Inner folders come after outer ones, so in reverse each is empty when its turn comes.
    for folder in reversed(folders):
        # One that still holds something stays.
        with suppress(OSError):
            folder.rmdir()

    # A folder that cannot be listed looks empty, but cannot be removed.
    if home.exists() and not left:
        left = {person: "something in it cannot be seen or deleted"}
    state = INCOMPLETE if left else DONE
    deleted = [name for name in names if name not in left]
    _note(root, {**entry, "state": state, "at": utc(), "deleted": deleted})

    return left, len(names)


def require_not_withdrawn(root: Path, person: str) -> None:
    """Raise UsageError for the pseudonym of a person who withdrew."""
    state = None
    for entry in read_events(root / WITHDRAWN):
        if entry.get("person") == person:
            # The last line counts: a deletion that was cut off may have ended later.
            state = entry["state"]

    if state == DONE:
        raise UsageError(
            f"{person} has withdrawn", next_step="give a pseudonym that is new"
        )

    if state is not None:
        raise UsageError(
            f"{person} has withdrawn, and the deletion did not end",
            cause="it was cut off, or a file could not be deleted",
            next_step=f"add --withdraw to delete what is left of {person}",
        )


def _note(root: Path, entry: dict[str, object]) -> None:
    """A line of withdrawn.jsonl, on the disk. Raises OutputError."""
    try:
        with (root / WITHDRAWN).open("a", encoding="utf-8") as lines:
            lines.write(json.dumps(entry) + "\n")
            lines.flush()
            # After a power cut the list must be there, or what is left could not be told.
            os.fsync(lines.fileno())
    except OSError as error:
        deleted = "nothing" if entry["state"] == BEGUN else "all"
        raise OutputError(
            f"cannot write ({error.strerror}); {deleted} is deleted",
            where=root / WITHDRAWN,
            cause="a full disk, or no permission",
            next_step="make room, then run it again with --withdraw",
        ) from None
