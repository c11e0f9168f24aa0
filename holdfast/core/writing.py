"""Results appear whole or not at all: written under a temporary name, then renamed.

A new file has the permissions that the umask leaves; a file that replaces another one keeps the
other's.
"""

from __future__ import annotations

import os
import secrets
import shutil
import tempfile
from collections.abc import Iterable, Iterator
from contextlib import contextmanager
from pathlib import Path

from holdfast.core.errors import OutputError

UNFINISHED = ".unfinished"
"""The end of a folder's name until everything in it is written."""


def write_whole(path: str | Path, data: bytes | str) -> Path:
    """Write a file so that no reader ever sees a part of it. Raises OutputError."""
    path = Path(path)
    # the name of a folder in it may be no UTF-8
    content = (
        data.encode("utf-8", "backslashreplace") if isinstance(data, str) else data
    )
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(8)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        try:
            # in the same folder, so that the rename cannot cross a file system
            with temporary.open("xb") as file:
                if path.exists():
                    shutil.copymode(path, temporary)
                file.write(content)
            os.replace(temporary, path)
        # KeyboardInterrupt too: no half-written file stays
        except BaseException:
            temporary.unlink(missing_ok=True)
            raise
    except OSError as error:
        raise _unwritable(path, error) from None
    return path


@contextmanager
def whole_folder(folder: Path) -> Iterator[Path]:
    """A folder to fill.

    It gets its name when the block ends, and is removed when the block fails.

    Until then it is called `<folder>.unfinished`, so that a killed program leaves nothing that
    looks whole. In a folder that exists it is `<folder>/.unfinished`, and its content moves up at
    the end, in place of files of the same names. Raises OutputError where nothing can be written,
    or where the unfinished folder of another run exists.
    """
    unfinished = (
        folder / UNFINISHED
        if folder.is_dir()
        else folder.with_name(folder.name + UNFINISHED)
    )
    try:
        unfinished.mkdir(parents=True)
    except FileExistsError:
        raise OutputError(
            "exists already",
            where=unfinished,
            cause="another run is writing it, or a run was killed",
            next_step="wait for that run, or remove this folder",
        ) from None
    except OSError as error:
        raise _unwritable(folder, error) from None
    try:
        yield unfinished
        _give_name(unfinished, folder)
    except BaseException:
        shutil.rmtree(unfinished, ignore_errors=True)
        raise


def _give_name(unfinished: Path, folder: Path) -> None:
    """Rename a finished folder, or move its content up. Raises OutputError."""
    try:
        if unfinished.parent != folder:
            unfinished.rename(folder)
            return
        # the folder was there before, so its content moves up file by file
        for path in sorted(unfinished.iterdir()):
            path.rename(folder / path.name)
        unfinished.rmdir()
    except OSError as error:
        raise _unwritable(folder, error) from None


def require_new(folder: Path) -> None:
    """Raise OutputError where a folder holds something, is a file, or cannot be written to."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise OutputError(
            "exists already, and is not empty",
            where=folder,
            next_step="name a new folder, or remove this one",
        )
    require_writable(folder)


def require_writable(folder: str | Path) -> None:
    """Check, before long work starts, that a folder or the place for it takes a file.

    Leaves nothing behind. Raises OutputError.
    """
    folder = Path(folder)
    there = next(
        place for place in (folder, *folder.absolute().parents) if place.exists()
    )
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from None


def require_free(path: Path, *, force: bool) -> None:
    """Raise OutputError for a file that exists and would be replaced. force: it may be."""
    if path.exists() and not force:
        raise OutputError(
            "exists already",
            where=path,
            cause="an earlier run of this command",
            next_step="name another file, or add --force to replace it",
        )


def require_outputs(
    outputs: Iterable[Path],
    inputs: Iterable[Path],
    *,
    force: bool,
    replaced: Iterable[Path] = (),
    folder: Path | None = None,
) -> None:
    """The rule for the files that a command writes, checked before it writes any of them.

    outputs: never an input, never one file twice, and replaced only with force. replaced: further
    outputs, which each run writes anew. folder: a new one, in which nothing else is written. Raises
    OutputError; leaves nothing behind.
    """
    known = {path.resolve(): "an input" for path in inputs}
    written = [] if folder is None else [folder.resolve()]
    for path in (*replaced, *outputs):
        # A device or a pipe would be replaced by a file of its name.
        if path.exists() and not path.is_file():
            what = "a folder" if path.is_dir() else "no regular file"
            raise OutputError(f"is {what}", where=path, next_step="name another file")
        where = path.resolve()
        # One file in the place of the folder of another cannot be, either.
        for other in written:
            if where.is_relative_to(other) or other.is_relative_to(where):
                known[where] = "another output, or in it or around it"
        if where in known:
            raise OutputError(
                f"is {known[where]}",
                where=path,
                cause="one file or folder was named twice, and would be lost",
                next_step="name another file",
            )
        written.append(where)
        require_writable(path.parent)
    for path in outputs:
        require_free(path, force=force)


def remove(path: Path) -> None:
    """Remove a file if it exists. Raises OutputError."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from None


def _unwritable(path: Path, error: OSError) -> OutputError:
    """The error for what the system refused."""
    return OutputError(
        f"cannot write ({error.strerror})",
        where=path,
        cause="no permission, a full disk, or a file in place of a folder",
        next_step="make room, or choose another place to write to",
    )
