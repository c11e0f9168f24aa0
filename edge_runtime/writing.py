"""Results appear whole or not at all: written under a temporary name beside the target, then renamed."""

from __future__ import annotations

import os
import tempfile
from pathlib import Path

from edge_runtime.errors import OutputError


def write_whole(path: str | Path, data: bytes | str) -> Path:
    """Write a file so that nobody ever sees half of it; OutputError where that cannot be done."""
    path = Path(path)
    content = data.encode() if isinstance(data, str) else data
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        handle, temporary = tempfile.mkstemp(prefix=f".{path.name}.", dir=path.parent)
        try:
            with os.fdopen(handle, "wb") as file:
                file.write(content)
            os.chmod(temporary, 0o644)
            os.replace(temporary, path)
        except BaseException:
            os.unlink(temporary)
            raise
    except OSError as error:
        raise _unwritable(path, error) from None
    return path


def require_writable(folder: str | Path) -> None:
    """See that a folder, or the place it would be made in, takes a file, before long work is lost on it.

    Leaves nothing behind. Raises OutputError.
    """
    folder = Path(folder)
    there = next(place for place in (folder, *folder.absolute().parents) if place.exists())
    try:
        with tempfile.TemporaryFile(dir=there):
            pass
    except OSError as error:
        raise _unwritable(folder, error) from None


def remove(path: Path) -> None:
    """Remove a file if it is there; OutputError where that cannot be done."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        raise _unwritable(path, error) from None


def _unwritable(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot write ({error.strerror})",
        where=path,
        cause="no permission, a full disk, or a file where a folder belongs",
        next_step="choose another place to write to",
    )
