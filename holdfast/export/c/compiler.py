"""The machine's own C compiler: a shared library of a C form, proved by its self-test."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from collections.abc import Mapping
from pathlib import Path

from holdfast.core.errors import CompilerFailed
from holdfast.edge_runtime.c_engine import LIBRARY

FLAGS = ("-std=c99", "-O2", "-ffp-contract=off")
"""-O3 makes three times the code for equal speed, and cold caches must fetch all of it."""
COMPILERS = ("cc", "gcc", "clang")
LONGEST_S = 600.0
"""A compiler that takes longer hangs."""
LONGEST_MESSAGE = 200


def compiled_library(files: Mapping[str, str], say_selftest: list[str]) -> bytes:
    """The bytes of libholdfast.so for these sources. Raises CompilerFailed.

    say_selftest: gets what the self-test, compiled with it, printed.
    """
    compiler = find_compiler()
    with tempfile.TemporaryDirectory(prefix="holdfast-c-") as name:
        folder = Path(name)
        for file, text in files.items():
            (folder / file).write_text(text, encoding="utf-8")
        _compile(compiler, folder, "-c", "-fPIC", "-o", "holdfast.o", "holdfast.c")
        _compile(compiler, folder, "-shared", "-o", LIBRARY, "holdfast.o", "-lm")
        _compile(
            compiler,
            folder,
            "-o",
            "selftest",
            "holdfast_selftest.c",
            "holdfast.o",
            "-lm",
        )
        say_selftest.append(_tested(folder / "selftest"))
        return (folder / LIBRARY).read_bytes()


def find_compiler() -> str:
    """The compiler in $CC, else the first of COMPILERS that knows C99. Raises CompilerFailed."""
    wanted = os.environ.get("CC", "")
    names = (wanted,) if wanted else COMPILERS
    for name in names:
        path = shutil.which(name)
        if path is not None:
            _require_c99(path)
            return path
    raise CompilerFailed(
        f"no C compiler ({', '.join(names)})",
        cause="none is installed"
        if not wanted
        else "CC names a program that is not there",
        next_step="install gcc or clang, or leave --build out and compile elsewhere",
    )


def _require_c99(compiler: str) -> None:
    with tempfile.TemporaryDirectory(prefix="holdfast-c-") as name:
        folder = Path(name)
        (folder / "try.c").write_text(
            "int main(void) { for (int i = 0; i < 1; ++i) {} return 0; }"
        )
        if _run(compiler, folder, *FLAGS, "-c", "-o", "try.o", "try.c").returncode:
            raise CompilerFailed(
                f"{compiler} does not take {' '.join(FLAGS)}",
                cause="it is too old, or no C compiler",
                next_step="set CC to gcc 4.6, clang 3.3 or newer",
            )


def _compile(compiler: str, folder: Path, *words: str) -> None:
    done = _run(compiler, folder, *FLAGS, *words)
    if done.returncode:
        lines = [line for line in done.stderr.splitlines() if "error" in line] or [
            done.stderr
        ]
        raise CompilerFailed(
            f"{compiler} failed: {lines[0]:.{LONGEST_MESSAGE}}",
            cause="a compiler that differs from those tested",
            next_step="set CC to another compiler",
        )


def _tested(program: Path) -> str:
    """What the self-test prints. Raises CompilerFailed where answers differ."""
    done = _run(str(program), program.parent)
    if done.returncode:
        raise CompilerFailed(
            f"the compiled model answers differently: {done.stdout:.{LONGEST_MESSAGE}}",
            cause="a compiler that does not follow IEEE 754",
            next_step="set CC to another compiler",
        )
    return done.stdout.strip()


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
