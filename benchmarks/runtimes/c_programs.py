"""The C form of a model by several compilers: labels, bits, and the time of a step."""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.runtimes.programs import called, require
from benchmarks.runtimes.stream import Stream

C = Path(__file__).parent / "c"
FLAGS = ("-std=gnu99", "-O3", "-ffp-contract=off")
SINGLE = ("-include", str(C / "single.h"), "-fsingle-precision-constant")
PASSES = 15


@dataclass(frozen=True)
class Compiled:
    """A compiler with its flags, and the program that runs what it makes (empty: this machine)."""

    name: str
    compiler: str
    flags: tuple[str, ...] = ()
    runner: tuple[str, ...] = ()


GCC = Compiled("C, gcc", "gcc")
CLANG = Compiled("C, clang", "clang")
AARCH64 = Compiled(
    "C, gcc, aarch64", "aarch64-linux-gnu-gcc", ("-static",), ("qemu-aarch64-static",)
)
SINGLE_GCC = Compiled("C, gcc, single precision", "gcc", SINGLE)


def installed(one: Compiled) -> bool:
    """Whether this machine has its compiler; gcc's C is the reference, so gcc must be there."""
    return one.compiler == GCC.compiler or shutil.which(one.compiler) is not None


@dataclass(frozen=True)
class StreamAnswers:
    """labels [T], everything else that a row leaves [T, bytes], and us a step."""

    labels: npt.NDArray[np.int32]
    rows: npt.NDArray[np.uint8]
    step_us: float


def answers_of(
    one: Compiled, sources: Path, stream: Stream, work: Path, passes: int = PASSES
) -> StreamAnswers:
    """What a compiled C form answers to a stream.

    Raises LibraryMissing without the programs, HoldfastError where one of them fails.
    """
    require(one.compiler, *one.runner[:1])
    real = np.float32 if one.flags == SINGLE else np.float64
    rows = stream.written(work / "stream.bin", real)
    program = compiled(one, sources, [C / "rows.c"], work / "rows")
    done = called([*one.runner, program, rows, str(passes)], work)
    answers = np.frombuffer(done.stdout, np.uint8).reshape(len(stream.values), -1)
    labels = np.ascontiguousarray(answers[:, :4]).view(np.int32)[:, 0]
    return StreamAnswers(labels, answers, float(done.stderr))


def golden_of(one: Compiled, sources: Path, work: Path) -> str:
    """What the self-test of a C form prints."""
    program = compiled(one, sources, [sources / "holdfast_selftest.c"], work / "selftest")
    return called([*one.runner, program], work).stdout.decode().strip()


def compiled(one: Compiled, sources: Path, mains: Sequence[Path], program: Path) -> Path:
    """The program of a C form and a file with a main."""
    files = [sources / "holdfast.c", *mains]
    words: list[str | Path] = [
        one.compiler,
        *FLAGS,
        *one.flags,
        "-I",
        sources,
        "-o",
        program,
        *files,
        "-lm",
    ]
    called(words, program.parent)
    return program
