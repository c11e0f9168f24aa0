"""A disk with little room: what is opened for writing takes so many bytes more, then ENOSPC."""

from __future__ import annotations

import errno
import os
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import pytest


class FullDisk:
    """room: bytes that still fit. written: bytes so far."""

    def __init__(self, room: float) -> None:
        self.room, self.written = room, 0

    def take(self, n_bytes: int) -> int:
        """How many of these bytes fit. Raises OSError where none does."""
        fits = int(min(n_bytes, self.room - self.written))
        if n_bytes and not fits:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        self.written += fits
        return fits


class _File:
    """An open file of that disk; like the system, it writes a part of what does not fit."""

    def __init__(self, file: Any, disk: FullDisk) -> None:
        self._file, self._disk = file, disk

    def write(self, data: Any) -> int:
        self._file.write(data[:0])  # a closed file says so, whatever the room
        fits = self._disk.take(len(data))
        self._file.write(data[:fits])
        if fits < len(data) and not self._is_raw:
            self._file.flush()
            self._disk.take(len(data) - fits)
        return fits

    @property
    def _is_raw(self) -> bool:
        """A raw file returns how much it wrote; a buffered one goes on and fails."""
        return not hasattr(self._file, "detach")

    def __getattr__(self, name: str) -> Any:
        return getattr(self._file, name)

    def __enter__(self) -> _File:
        return self

    def __exit__(self, *error: object) -> None:
        self._file.close()


@contextmanager
def full_disk(room: float) -> Iterator[FullDisk]:
    """Every file that is opened by its path for writing is on a disk with this much room."""
    disk, plain = FullDisk(room), Path.open

    def opened(path: Path, mode: str = "r", *args: Any, **more: Any) -> Any:
        file = plain(path, mode, *args, **more)
        return file if set(mode).isdisjoint("wax+") else _File(file, disk)

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(Path, "open", opened)
        yield disk
