"""Before anything from outside is read to its end: is it a file at all, and is its JSON ours to walk through."""

from __future__ import annotations

import json
import stat
from pathlib import Path
from typing import Any

from edge_runtime.errors import DataNotFound

MOST_LEVELS = 32
"""Nothing of ours nests deeper; a thousand brackets in a row end Python's own stack."""


def require_file(path: Path) -> None:
    """Raise DataNotFound for a device or a pipe, which may never end, and for a path that cannot be one.

    Where there is nothing, whoever opens it says so; and so for a folder.
    """
    try:
        mode = path.stat().st_mode
    except (FileNotFoundError, NotADirectoryError, PermissionError):
        return
    except (OSError, ValueError) as error:
        what = error.strerror if isinstance(error, OSError) else str(error)
        raise DataNotFound(f"no path of a file ({what})", where=repr(str(path))[:80], next_step="check it") from None
    if not stat.S_ISREG(mode) and not stat.S_ISDIR(mode):
        raise DataNotFound(
            "a device or a pipe where a file belongs", where=path, next_step="write it to a file first, and name that"
        )


def json_of(text: str | bytes) -> Any:
    """json.loads that has one error only: ValueError, also for what is nested too deep."""
    try:
        value = json.loads(text)
    except RecursionError:
        raise ValueError("nested too deep") from None
    level = [value]
    for _ in range(MOST_LEVELS):
        level = [one for inner in level for one in _within(inner)]
        if not level:
            return value
    raise ValueError("nested too deep")


def _within(value: Any) -> list[Any]:
    """The lists and objects one level down."""
    inner = value.values() if isinstance(value, dict) else value if isinstance(value, list) else ()
    return [one for one in inner if isinstance(one, dict | list)]
