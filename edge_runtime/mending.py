"""Repair of a line file that a kill or a power cut has torn: its end moves to `<file>.torn`.

A killed program leaves a part of a line; a power cut may leave zeros behind it. Nothing is deleted.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from holdfast.edge_runtime.errors import EmptyRecording, OutputError
from holdfast.edge_runtime.writing import write_whole

TORN = ".torn"


@dataclass(frozen=True)
class MendResult:
    """The result of a repair.

    Whole lines of data, bytes of the torn end, and the file that has them.

    torn is None where nothing was torn.
    """

    rows: int
    cut_bytes: int
    torn: Path | None


def mend_lines(path: Path, is_whole: Callable[[bytes], bool]) -> MendResult:
    """Move the torn end of a file without a header to its own file.

    is_whole: judges a last line without its newline. Raises EmptyRecording without a file,
    OutputError.
    """
    data = read_damaged(path)
    text = data.rstrip(b"\0")
    begin = text.rfind(b"\n") + 1
    kept_bytes = len(text) if begin == len(text) or is_whole(text[begin:]) else begin
    lines = [line for line in text[:kept_bytes].split(b"\n") if line.strip()]
    return MendResult(len(lines), len(data) - kept_bytes, move_aside(path, data, kept_bytes))


def move_aside(path: Path, data: bytes, kept_bytes: int) -> Path | None:
    """Copy the data after kept_bytes to a new file, then cut the original there; None without any.

    An earlier torn end is never overwritten.
    """
    torn = data[kept_bytes:]
    if not torn:
        return None
    target, number = path.with_name(path.name + TORN), 1
    while target.exists() and read_damaged(target) != torn:
        number += 1
        target = path.with_name(f"{path.name}{TORN}{number}")
    write_whole(target, torn)
    try:
        os.truncate(path, kept_bytes)
    except OSError as error:
        raise _unmended(path, error) from None
    return target


def read_damaged(path: Path) -> bytes:
    """A file's bytes.

    Raises EmptyRecording without the file, OutputError where it cannot be read.
    """
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise EmptyRecording(
            "does not exist",
            where=path,
            cause="the recorder was killed at once",
            next_step="record again",
        ) from None
    except OSError as error:
        raise _unmended(path, error) from None


def _unmended(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot be repaired ({error.strerror})",
        where=path,
        next_step="copy the file and repair the copy",
    )
