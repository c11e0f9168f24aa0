"""A sealed model file -> a folder of C, written whole or not at all."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from holdfast.core.errors import OutputError
from holdfast.core.writing import require_writable, whole_folder, write_whole
from holdfast.edge_runtime.c_engine import LIBRARY
from holdfast.export.c.compiler import compiled_library
from holdfast.export.c.graph import read_graph
from holdfast.export.c.source import CSource, c_source


@dataclass(frozen=True)
class CExport:
    """What was written. selftest: what the compiled self-test printed; empty without --build."""

    names: list[str]
    source: CSource
    selftest: list[str]


def export_c(
    model: Path, folder: Path, *, build: bool = False, force: bool = False
) -> CExport:
    """Write the C form of a model. Raises a ModelError, CompilerFailed or OutputError."""
    graph = read_graph(model)
    names = ["holdfast.c", "holdfast.h", "holdfast_selftest.c"]
    if build:
        names.append(LIBRARY)
    _require_free(folder, names, force=force)
    require_writable(folder)
    source = c_source(graph)
    contents: dict[str, str | bytes] = dict(source.files)
    selftest: list[str] = []
    if build:
        contents[LIBRARY] = compiled_library(source.files, selftest)
    with whole_folder(folder) as unfinished:
        for name, content in contents.items():
            write_whole(unfinished / name, content)
    return CExport(names, source, selftest)


def _require_free(folder: Path, names: list[str], *, force: bool) -> None:
    if folder.exists() and not folder.is_dir():
        raise OutputError(
            "is a file, not a folder",
            where=folder,
            next_step="name another folder with --out",
        )
    there = [name for name in names if (folder / name).exists()]
    if there and not force:
        raise OutputError(
            "exists already",
            where=folder / there[0],
            cause="an earlier export",
            next_step="name a new folder with --out, or add --force to replace it",
        )
