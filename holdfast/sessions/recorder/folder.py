"""The folder of recordings: its owner, one recorder at a time, trial numbers, discarded trials.

The repair of one trial's folder, for `holdfast check --repair`.
"""

from __future__ import annotations

import fcntl
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from holdfast.core.contract import Json
from holdfast.core.errors import (
    ChannelError,
    DataNotFound,
    EmptyRecording,
    HoldfastError,
    OutputError,
    UnitError,
    count_of,
)
from holdfast.core.hand_card import HandCard
from holdfast.core.schema import json_of, text_of
from holdfast.core.tactile_file import RepairResult, repair_lines, repair_table
from holdfast.core.trial_layout import DISCARDED, EVENTS, HAND_FILE, META, TACTILE
from holdfast.core.writing import require_writable, write_whole
from holdfast.sessions.recorder.labels import read_meta
from holdfast.sessions.recorder.plan import NOTHING, Task

FORMAT = 1
"""Version of the layout, in every meta.json."""
KEPT = "kept"
RECORDING = "recording"
INTERRUPTED = "interrupted"
REDONE = "redone"
VOID = "void"
"""It ended before its first sample."""
LOCK = ".holdfast.lock"
"""Its lock holds while a recorder or a study runs; the file itself stays."""
_RESERVED: set[Path] = set()
"""Folders that a study of this very program holds."""


def write_meta(folder: Path, meta: Json) -> None:
    """Write meta.json of a folder. Raises OutputError."""
    write_whole(folder / META, json.dumps(meta, indent=1, default=str) + "\n")


@contextmanager
def recording_folder(root: Path, unit: str, kind: str) -> Iterator[None]:
    """Hold a folder of recordings, new or existing, for one recorder.

    kind: recorded, simulated or replayed. Raises OutputError (not a recording folder, or another
    recorder uses it), UnitError (it holds trials of another unit or kind).
    """
    there = require_ours(root)
    require_writable(root)
    root.mkdir(parents=True, exist_ok=True)
    (root / LOCK).touch()

    # A lock of the kernel's: it ends with the process, however that ends.
    with folder_lock(root):
        if there:
            _require_same(root, there, unit, kind)
        else:
            name = root.resolve().name
            meta = {"recorder": FORMAT, "name": name, "kind": kind, "unit": unit}
            write_meta(root, meta)
        try:
            yield
        except HoldfastError:
            # A run that is refused leaves no new folder; one with a trial in it stays.
            if not there and {path.name for path in root.iterdir()} == {LOCK, META}:
                shutil.rmtree(root)
            raise


def _root_of(place: Path) -> Path | None:
    """The folder of recordings that a place is, or is in; None outside one."""
    whole = place.absolute()
    for root in (whole, *whole.parents):
        if (root / LOCK).is_file():
            return root
    return None


@contextmanager
def folder_lock(place: Path) -> Iterator[None]:
    """No other recorder uses the folder of recordings meanwhile. Raises OutputError."""
    # The place may be a person or a trial in it.
    root = _root_of(place)
    # A study of this program holds it already.
    if root is None or root in _RESERVED:
        yield
        return
    with (root / LOCK).open() as lock:
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except OSError:
            raise OutputError(
                "another recorder or study is using it",
                where=root,
                cause="a second terminal",
                next_step="end that program first, or name another folder",
            ) from None
        yield


@contextmanager
def program_lock(root: Path) -> Iterator[None]:
    """Hold a recording folder for this program, whose trials then need no lock of their own.

    Raises OutputError where another recorder or study uses it.
    """
    with folder_lock(root):
        _RESERVED.add(root.absolute())
        try:
            yield
        finally:
            _RESERVED.clear()


def require_ours(root: Path) -> Json:
    """meta.json of a folder of recordings; empty for a new or empty folder. Raises OutputError."""
    above = _root_of(root.absolute().parent)
    if above is not None:
        # A person's data would be in two places, and a withdrawal would delete only one.
        raise OutputError(
            "is within a recording folder",
            where=root,
            cause="the recorder makes the person's folder itself",
            next_step=f"--out {above}",
        )

    if not root.exists():
        return {}
    if root.is_dir():
        meta = read_meta(root)
        # A run that was refused early may have left its lock and nothing else.
        is_empty = all(path.name == LOCK for path in root.iterdir())
        if is_empty or meta.get("recorder") == FORMAT:
            return meta
    raise OutputError(
        "exists but is not a recording folder",
        where=root,
        cause="the name of another folder",
        next_step="name a new folder; nothing is ever overwritten",
    )


def _require_same(root: Path, there: Json, unit: str, kind: str) -> None:
    for name, ours in (("unit", unit), ("kind", kind)):
        if there.get(name) != ours:
            raise UnitError(
                f"holds trials of the {name} {there.get(name)}, these would be {ours}",
                where=root,
                cause="a calibration or a source that is another than before",
                next_step="name another folder, so that each has a name of its own",
            )


def keep_hand(root: Path, card: HandCard, n_sensors: int) -> None:
    """Put the hand card beside the recordings, where training reads it.

    Raises ChannelError for a card of another hand, OutputError where it cannot be written.
    """
    path = root / HAND_FILE
    is_another = path.is_file() and text_of(path) != card.text
    if is_another or card.n_sensors != n_sensors:
        raise ChannelError(
            f"{card.name} is the card of another hand",
            where="--hand",
            cause=f"{n_sensors} sensors answer, {card.n_sensors} are on the card, or {root} has "
            "recordings with another card",
            next_step="give the card of this hand, or another --out",
        )
    write_whole(path, card.text)


# -- trials


def task_folder(root: Path, person: str, task: Task) -> Path:
    """Where trials of a task lie."""
    home = root / person
    if task.action == NOTHING:
        return home / NOTHING
    return home / task.object / task.action


def new_trial(root: Path, person: str, task: Task) -> Path:
    """The next trial's folder, made. Raises OutputError."""
    place = task_folder(root, person, task)
    # After the highest number that is there: a gap below it is not filled.
    taken = [number(path) for path in place.glob("*")]
    folder = place / f"trial_{max(taken, default=0) + 1}"
    with written(folder, "cannot be made"):
        folder.mkdir(parents=True)
    return folder


@contextmanager
def written(
    path: Path, what: str = "cannot write", next_step: str = "make room"
) -> Iterator[None]:
    """An OSError within is an OutputError: a file or folder that cannot be written, or moved."""
    try:
        yield
    except OSError as error:
        raise OutputError(
            f"{what} ({error.strerror})",
            where=path,
            cause="a full disk, or no permission",
            next_step=next_step,
        ) from None


def number(folder: Path) -> int:
    """3 of trial_3; 0 of anything else."""
    digits = folder.name.removeprefix("trial_")
    return int(digits) if digits.isdecimal() else 0


def discard(root: Path, person: str, folder: Path) -> Path:
    """Move a trial to the person's discarded ones; returns its new path. Raises OutputError."""
    meta = read_meta(folder)
    if meta.get("state") == KEPT:
        # Before it is moved: training reads whatever is kept, wherever it lies.
        write_meta(folder, meta | {"state": REDONE})
    home = root / person
    place = home / DISCARDED / folder.parent.relative_to(home)
    with written(folder, "cannot be moved"):
        place.mkdir(parents=True, exist_ok=True)
        # The same trial may be repeated several times.
        earlier = len(list(place.glob(f"{folder.name}-*")))
        return folder.rename(place / f"{folder.name}-{earlier + 1}")


def trials_of(root: Path, person: str) -> list[tuple[Path, Json]]:
    """The trials of a person with their meta.json, without the discarded ones."""
    home = root / person
    trials = []
    for path in sorted(home.rglob(f"trial_*/{META}")):
        if DISCARDED not in path.relative_to(home).parts:
            trials.append((path.parent, read_meta(path.parent)))
    return trials


def done(root: Path, person: str) -> list[Task]:
    """The tasks of a person's kept trials."""
    tasks = []
    for _, meta in trials_of(root, person):
        if meta.get("state") == KEPT:
            tasks.append(Task(meta["object"], meta["action"], meta.get("style", "")))
    return tasks


def all_trials(root: Path) -> list[Path]:
    """The folders of all trials in a folder, discarded ones too; or the folder itself.

    A trial that was interrupted before it had a tactile.csv has a meta.json. Raises DataNotFound.
    """
    folders = {path.parent for path in root.rglob(TACTILE)}
    for path in root.rglob(META):
        if path.parent.name.startswith("trial_"):
            folders.add(path.parent)

    if not folders:
        raise DataNotFound(
            "no trial in this folder",
            where=root,
            next_step="give a trial's folder, or one with trials in it",
        )

    return sorted(folders)


# -- repair


def repair(folder: Path) -> list[str]:
    """Repair one trial; returns what was done, in words.

    Raises a DataError or OutputError; what is whole in the trial is then unchanged.
    """
    meta = read_meta(folder)
    state = meta.get("state")
    try:
        samples = repair_table(folder / TACTILE)
    except EmptyRecording:
        if state == KEPT:
            raise
        return [_voided(folder, meta)]

    count = count_of(samples.rows, "sample")
    done = _removed(samples, f"line removed, {count} complete")
    if (folder / EVENTS).exists():
        events = repair_lines(folder / EVENTS, is_json_object)
        done += _removed(events, "event removed")
    if state == RECORDING:
        # The samples before the cut are whole, but the trial is not: training leaves it out.
        meta |= {"state": INTERRUPTED, "why": f"cut off; repaired, {count}"}
        write_meta(folder, meta)
        done.append(f"marked as interrupted with {count}")
    return done


def _voided(folder: Path, meta: Json) -> str:
    """A trial that ended before its header: marked as void, once."""
    state = meta.get("state")
    if state == RECORDING or (not meta and (folder / TACTILE).exists()):
        why = "cut off before its header was written"
        write_meta(folder, {"recorder": FORMAT, **meta, "state": VOID, "why": why})
        return "marked as void: it ended before its header was written"
    return f"{state or 'not a trial'}: no sample was recorded"


def _removed(result: RepairResult, what: str) -> list[str]:
    """What was moved out of a file, and where it is now."""
    if result.torn is None:
        return []
    removed = f"{result.cut_bytes} bytes of an incomplete {what}"
    return [removed, f"they are in {result.torn.name}"]


def is_json_object(line: bytes) -> bool:
    """Whether a line is a complete JSON object."""
    try:
        return isinstance(json_of(line), dict)
    except ValueError:
        return False
