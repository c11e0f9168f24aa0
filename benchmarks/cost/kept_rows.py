"""Rows that are computed once and kept in a file, complete or not at all."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.export.heads import FloatRows


def digest_of(settings: Any) -> str:
    """12 hex digits that name the settings of rows, for a file name; settings: JSON values."""
    # Sorted keys: the order in which settings are listed does not change the name of the file.
    text = json.dumps(settings, sort_keys=True)
    return hashlib.sha256(text.encode()).hexdigest()[:12]


def kept_rows(path: Path, compute: Callable[[], FloatRows]) -> FloatRows:
    """[N, F] rows of a file, mapped into memory; computed and written first if it is not there.

    An interrupted run leaves no file of that name.
    """
    if not path.is_file():
        path.parent.mkdir(parents=True, exist_ok=True)
        # Renamed only when it is complete.
        half = path.with_suffix(".half.npy")
        np.save(half, compute())
        half.replace(path)

    # Mapped and not read at once, so that only the rows in use take memory.
    rows: FloatRows = np.load(path, mmap_mode="r")
    return rows
