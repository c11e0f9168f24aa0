"""The base that an adaptation starts from: the file itself, or the base inside an adapted file."""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from holdfast.edge_runtime.model import Model
from holdfast.edge_runtime.model_file import read_sealed
from holdfast.export.adapted_file import is_adapted, undone


@contextmanager
def base_model(path: Path) -> Iterator[tuple[Model, bytes]]:
    """The opened base model and its bytes. Raises what opening a model raises."""
    data = read_sealed(path)
    if not is_adapted(data):
        yield Model(path), data
        return
    base = undone(data, path)
    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / path.name
        file.write_bytes(base)
        yield Model(file), base
