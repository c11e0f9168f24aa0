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
        next_step="choose another place with --out",
    )
