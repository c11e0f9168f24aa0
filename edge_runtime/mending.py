"""The end of a file of lines that a kill or a power cut has torn, moved to `<file>.torn`; nothing
is deleted.

A killed program leaves a part of a line; a power cut may leave zeros behind it.
"""

from __future__ import annotations

import os
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path

from edge_runtime.errors import EmptyRecording, OutputError
from edge_runtime.writing import write_whole

TORN = ".torn"


@dataclass(frozen=True)
class Mended:
    """What mending found: whole lines of data, bytes of a torn end, and the file they are in now
    (None without)."""

    rows: int
    cut_bytes: int
    torn: Path | None


def mend_lines(path: Path, is_whole: Callable[[bytes], bool]) -> Mended:
    """Move the torn end of a file without a header aside; is_whole judges a last line without its
    newline.

    Raises EmptyRecording without a file, OutputError.
    """
    data = read_damaged(path)
    text = data.rstrip(b"\0")
    begin = text.rfind(b"\n") + 1
    kept_bytes = len(text) if begin == len(text) or is_whole(text[begin:]) else begin
    lines = [line for line in text[:kept_bytes].split(b"\n") if line.strip()]
    return Mended(len(lines), len(data) - kept_bytes, move_aside(path, data, kept_bytes))


def move_aside(path: Path, data: bytes, kept_bytes: int) -> Path | None:
    """Write data after kept_bytes beside a file, then cut the file there; an earlier torn end is
    never replaced."""
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
    """A file as it is. Raises EmptyRecording without one, OutputError where it cannot be read."""
    try:
        return path.read_bytes()
    except FileNotFoundError:
        raise EmptyRecording(
            "is not there", where=path, cause="killed at once", next_step="record again"
        ) from None
    except OSError as error:
        raise _unmended(path, error) from None


def _unmended(path: Path, error: OSError) -> OutputError:
    return OutputError(
        f"cannot be mended ({error.strerror})", where=path, next_step="copy it, mend that"
    )
