"""A sealed model file -> a folder of C, written whole or not at all.

The machine's C compiler, where there is one, makes a shared library of it, proved by its self-test.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

from holdfast.core.errors import CompilerFailed
from holdfast.core.schema import LIBRARY, c_folder
from holdfast.core.writing import (
    require_free,
    require_writable,
    whole_folder,
    write_whole,
)
from holdfast.export.c.graph import read_graph
from holdfast.export.c.source import c_source

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
"""How a library is compiled.

C99 is enough for all that is generated. -O3 makes three times the code for equal speed, and cold
caches must fetch all of it. -ffp-contract=off keeps a compiler from fusing products and sums, which
round once where two operations round twice: so all compilers give the same bits.
"""
ON_A_BOARD = f"cc {' '.join(FLAGS)} -shared -fPIC -o {LIBRARY} holdfast.c -lm"
"""Typed in a copy of the folder, it makes the library on a board that has no exporter."""
COMPILERS = ("cc", "gcc", "clang")
"""Tried in this order where $CC names none."""
LONGEST_S = 600.0
"""A compiler that takes longer hangs."""
LONGEST_MESSAGE = 200
"""Characters of a compiler's output that an error quotes."""


@dataclass(frozen=True)
class CExport:
    """What was written. selftest: what the compiled self-test printed; empty without a library.

    files: their names. The memory of one hand, in bytes: state, kept from sample to sample; tables,
    constants that all hands of a program share; stack of one step, while it runs.
    """

    files: list[str]
    state_bytes: int
    table_bytes: int
    stack_bytes: int
    selftest: list[str]


def export_c(
    model: Path, folder: Path, *, build: bool | None = False, force: bool = False
) -> CExport:
    """Write the C form of a model. Raises a ModelError, CompilerFailed or OutputError.

    build: compile it too; None: where there is a compiler.
    """
    if build is None:
        build = find_compiler() is not None
    files, step = c_source(read_graph(model))
    names = [*files, LIBRARY] if build else [*files]
    # before the compiler runs, which takes a while
    require_writable(folder)
    for name in names:
        require_free(folder / name, force=force)

    contents: dict[str, str | bytes] = {**files}
    selftest: list[str] = []
    if build:
        contents[LIBRARY], printed = compiled_library(files)
        selftest.append(printed)

    # all files or none: a header of one model must never stand next to the code of another
    with whole_folder(folder) as unfinished:
        for name, content in contents.items():
            write_whole(unfinished / name, content)

    table_bytes = step.tables.n_bytes
    return CExport(names, step.state_bytes, table_bytes, step.stack_bytes, selftest)


def compiled_library(files: Mapping[str, str]) -> tuple[bytes, str]:
    """The bytes of libholdfast.so for these sources, and what its self-test printed.

    Raises CompilerFailed.
    """
    compiler = find_compiler()
    if compiler is None:
        raise CompilerFailed(
            f"no C compiler (CC, {', '.join(COMPILERS)})",
            next_step="install gcc or clang, or compile elsewhere: --no-build",
        )
    with tempfile.TemporaryDirectory(prefix="holdfast-c-") as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")

        # position-independent, as a shared library needs
        _compile(compiler, folder, "-c", "-fPIC", "-o", "holdfast.o", "holdfast.c")
        _compile(compiler, folder, "-shared", "-o", LIBRARY, "holdfast.o", "-lm")
        # the self-test runs the same object file that the library is made of
        parts = ("holdfast_selftest.c", "holdfast.o", "-lm")
        _compile(compiler, folder, "-o", "selftest", *parts)

        # what the self-test prints, unless answers differ
        done = _run(str(folder / "selftest"), folder)
        if done.returncode:
            raise CompilerFailed(
                f"the compiled model answers differently: {done.stdout:.{LONGEST_MESSAGE}}",
                cause="a compiler that does not follow IEEE 754",
                next_step="set CC to another compiler",
            )
        return (folder / LIBRARY).read_bytes(), done.stdout.strip()


def folder_for(model: Path) -> Path:
    """Where the C form of a model goes by default: beside it, or here where that takes none."""
    beside = c_folder(model)
    return beside if os.access(beside.parent, os.W_OK) else Path(beside.name)


def find_compiler() -> str | None:
    """The compiler in $CC, else the first of COMPILERS; None where there is none."""
    named = os.environ.get("CC")
    found = map(shutil.which, (named,) if named else COMPILERS)
    return next(filter(None, found), None)


def _compile(compiler: str, folder: Path, *words: str) -> None:
    """Run the compiler in a folder. Raises CompilerFailed with its first error."""
    done = _run(compiler, folder, *FLAGS, *words)
    if done.returncode:
        # warnings and notes of a header can come first
        errors = [line for line in done.stderr.splitlines() if "error" in line]
        first = errors[0] if errors else done.stderr
        raise CompilerFailed(
            f"{compiler} failed: {first:.{LONGEST_MESSAGE}}",
            cause="too old for C99, or no C compiler",
            next_step="set CC to gcc 4.6, clang 3.3 or newer",
        )


def _run(program: str, folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Run a program to its end. Raises CompilerFailed where it cannot be started or hangs."""
    try:
        return subprocess.run(
            [program, *words],
            cwd=folder,
            capture_output=True,
            text=True,
            errors="replace",
            timeout=LONGEST_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise CompilerFailed(
            f"{program} cannot be run ({error!s:.{LONGEST_MESSAGE}})",
            next_step="set CC to another compiler",
        ) from None
