"""The folder of recordings: its owner, one recorder at a time, trial numbers, discarded trials.

The repair of one trial's folder, for `holdfast repair`.
"""

from __future__ import annotations

import fcntl
import json
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from pathlib import Path

from holdfast.core.errors import (
    DataNotFound,
    EmptyRecording,
    OutputError,
    UnitError,
    UsageError,
)
from holdfast.core.reading import Json, json_of
from holdfast.core.tactile_file import MendResult, mend, mend_lines
from holdfast.core.trial_layout import DISCARDED, EVENTS, META, TACTILE
from holdfast.core.writing import require_writable, write_whole
from holdfast.sessions.recorder.labels import read_meta
from holdfast.sessions.recorder.protocol import NOTHING, Task

FORMAT = 1
KEPT, RECORDING, INTERRUPTED, REDONE, VOID = (
    "kept",
    "recording",
    "interrupted",
    "redone",
    "void",
)
LOCK = ".holdfast.lock"


@contextmanager
def opened(root: Path, unit: str, kind: str) -> Iterator[None]:
    """Hold a folder of recordings, new or existing, for one recorder.

    kind: recorded, simulated or replayed. Raises OutputError (not a recording folder, or another
    recorder uses it), UnitError, UsageError (it holds trials of another kind).
    """
    there = require_ours(root)
    require_writable(root)
    root.mkdir(parents=True, exist_ok=True)
    (root / LOCK).touch()
    with alone(root):
        if there:
            _require_same(root, there, unit, kind)
        else:
            meta = {
                "recorder": FORMAT,
                "name": root.resolve().name,
                "kind": kind,
                "unit": unit,
            }
            write_whole(root / META, json.dumps(meta, indent=1) + "\n")
        yield


@contextmanager
def alone(place: Path) -> Iterator[None]:
    """No other recorder uses the folder, or one above it, meanwhile. Raises OutputError."""
    with ExitStack() as held:
        for root in (place, *place.absolute().parents):
            if not (root / LOCK).is_file():
                continue
            try:
                fcntl.flock(
                    held.enter_context((root / LOCK).open()),
                    fcntl.LOCK_EX | fcntl.LOCK_NB,
                )
            except OSError:
                raise OutputError(
                    "another recorder is using it",
                    where=root,
                    cause="a second terminal",
                    next_step="stop that recorder first",
                ) from None
        yield


def require_ours(root: Path) -> Json:
    """meta.json of a folder of recordings; empty for a new or empty folder. Raises OutputError."""
    _require_not_within(root)
    if root.is_dir():
        meta = read_meta(root)
        if meta.get("recorder") == FORMAT or not any(
            path.name != LOCK for path in root.iterdir()
        ):
            return meta
    elif not root.exists():
        return {}
    raise OutputError(
        "exists but is not a recording folder",
        where=root,
        cause="the name of another folder",
        next_step="name a new folder; nothing is ever overwritten",
    )


def _require_not_within(root: Path) -> None:
    """Raise OutputError within a recording folder: a person would have data in two places."""
    for above in root.absolute().parents:
        if (above / LOCK).is_file() and read_meta(above).get("recorder") == FORMAT:
            raise OutputError(
                "is within a recording folder",
                where=root,
                cause="the recorder makes the person's folder itself",
                next_step=f"--out {above}",
            )


def _require_same(root: Path, there: Json, unit: str, kind: str) -> None:
    if there.get("unit") != unit:
        raise UnitError(
            f"holds trials in {there.get('unit')}, the source is in {unit}",
            where=root,
            cause="with a calibration before and without now, or the other way",
            next_step="name another folder",
        )
    if there.get("kind") != kind:
        raise UsageError(
            f"{root}: holds trials that are {there.get('kind')}, these would be {kind}",
            next_step="name another folder, so that each has a name of its own",
        )


def task_folder(root: Path, person: str, task: Task) -> Path:
    """Where trials of a task lie."""
    return (
        root / person / NOTHING
        if task.action == NOTHING
        else root / person / task.thing / task.action
    )


def new_trial(root: Path, person: str, task: Task) -> Path:
    """The next trial's folder, made. Raises OutputError."""
    place = task_folder(root, person, task)
    taken = [number(path) for path in place.iterdir()] if place.is_dir() else []
    folder = place / f"trial_{max(taken, default=0) + 1}"
    try:
        folder.mkdir(parents=True)
    except OSError as error:
        raise OutputError(
            f"cannot be made ({error.strerror})", where=folder, next_step="make room"
        ) from None
    return folder


def number(folder: Path) -> int:
    """3 of trial_3; 0 of anything else."""
    digits = folder.name.removeprefix("trial_")
    return int(digits) if digits.isdecimal() and len(digits) < 9 else 0


def discard(root: Path, person: str, folder: Path) -> Path:
    """Move a trial to the person's discarded ones; returns its new path. Raises OutputError.

    A kept trial is marked as redone first: training reads whatever is kept, wherever it lies.
    """
    meta = read_meta(folder)
    if meta.get("state") == KEPT:
        write_whole(
            folder / META, json.dumps({**meta, "state": REDONE}, indent=1) + "\n"
        )
    place = root / person / DISCARDED / folder.parent.relative_to(root / person)
    try:
        place.mkdir(parents=True, exist_ok=True)
        target = (
            place
            / f"{folder.name}-{1 + sum(1 for _ in place.glob(f'{folder.name}-*'))}"
        )
        folder.rename(target)
    except OSError as error:
        raise OutputError(
            f"cannot be moved ({error.strerror})",
            where=folder,
            next_step="move it yourself",
        ) from None
    return target


def trials_of(root: Path, person: str) -> list[tuple[Path, Json]]:
    """The trials of a person with their meta.json, without the discarded ones."""
    home = root / person
    folders = [
        path.parent
        for pattern in ("*/trial_*", "*/*/trial_*")
        for path in home.glob(f"{pattern}/{META}")
    ]
    there = [
        folder
        for folder in sorted(folders)
        if DISCARDED not in folder.relative_to(home).parts
    ]
    return [(folder, read_meta(folder)) for folder in there]


def done(root: Path, person: str) -> list[Task]:
    """The tasks of a person's kept trials."""
    kept = [meta for _, meta in trials_of(root, person) if meta.get("state") == KEPT]
    return [
        Task(str(m.get("object")), str(m.get("action")), str(m.get("style")))
        for m in kept
    ]


def all_trials(root: Path) -> list[Path]:
    """The folders of all trials in a folder, discarded ones too; or the folder itself.

    A trial that was interrupted before it had a tactile.csv has a meta.json. Raises DataNotFound.
    """
    with_samples = {path.parent for path in root.rglob(TACTILE)}
    begun = {
        path.parent
        for path in root.rglob(META)
        if path.parent.name.startswith("trial_")
    }
    folders = sorted(with_samples | begun)
    if not folders:
        raise DataNotFound(
            "no trial in this folder",
            where=root,
            next_step="give a trial's folder, or one with trials in it",
        )
    return folders


def repaired(folder: Path) -> list[str]:
    """Repair one trial; returns what was done, in words.

    Raises a DataError or OutputError; what is whole in the trial is then unchanged.
    """
    try:
        return _repaired(folder)
    except OutputError as error:
        step = "make room, then run holdfast repair again"
        raise OutputError(
            error.what, where=error.where, cause=error.cause, next_step=step
        ) from None


def _repaired(folder: Path) -> list[str]:
    meta = read_meta(folder)
    try:
        mended = mend(folder / TACTILE)
    except EmptyRecording:
        if meta.get("state") == KEPT:
            raise
        return _voided(folder, meta)
    done = _in_words(mended, f"incomplete line removed, {mended.rows} samples complete")
    if (folder / EVENTS).exists():
        done += _in_words(
            mend_lines(folder / EVENTS, _is_event), "incomplete event removed"
        )
    if meta.get("state") == RECORDING:
        _mark(folder, meta, INTERRUPTED, f"cut off; mended, {mended.rows} samples")
        done.append(f"marked as interrupted with {mended.rows} samples")
    return done


def _voided(folder: Path, meta: Json) -> list[str]:
    """A trial that ended before its header: marked as void, once."""
    begun = meta.get("state") == RECORDING or (not meta and (folder / TACTILE).exists())
    if begun:
        _mark(
            folder,
            {"recorder": FORMAT, **meta},
            VOID,
            "cut off before its header was written",
        )
        return ["marked as void: it ended before its header was written"]
    return [f"{meta.get('state', 'not a trial')}: no sample was recorded"]


def _mark(folder: Path, meta: Json, state: str, why: str) -> None:
    write_whole(
        folder / META, json.dumps({**meta, "state": state, "why": why}, indent=1) + "\n"
    )


def _in_words(mended: MendResult, what: str) -> list[str]:
    if mended.torn is None:
        return []
    return [f"{mended.cut_bytes} bytes of an {what}", f"they are in {mended.torn.name}"]


def _is_event(line: bytes) -> bool:
    """Whether a line is a complete JSON object."""
    try:
        return isinstance(json_of(line), dict)
    except ValueError:
        return False
