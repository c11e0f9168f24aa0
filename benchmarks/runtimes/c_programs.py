"""The C form of a model by several compilers: labels, bits, and the time of a step."""

from __future__ import annotations

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from benchmarks.runtimes.programs import called, require
from benchmarks.runtimes.stream import Stream

C = Path(__file__).parent / "c"
ROOT = Path(__file__).resolve().parents[2]
BROWSER = ROOT / "examples/browser"
FLAGS = ("-std=gnu99", "-O2", "-ffp-contract=off")
SINGLE = ("-include", str(C / "single.h"), "-fsingle-precision-constant")
PASSES = 15


@dataclass(frozen=True)
class Compiled:
    """A compiler with its flags, what runs what it makes (empty: this machine), and a main.

    also: more programs that it needs. first: words that its own program begins with.
    """

    name: str
    compiler: str
    flags: tuple[str, ...] = ()
    runner: tuple[str, ...] = ()
    main: Path = C / "rows.c"
    linked: tuple[str, ...] = ("-lm",)
    also: tuple[str, ...] = ()
    first: tuple[str, ...] = ()

    @property
    def programs(self) -> tuple[str, ...]:
        """What must be installed."""
        return (self.compiler, *self.runner[:1], *self.also)

    @property
    def is_installed(self) -> bool:
        """Whether this machine has all of it."""
        return all(shutil.which(name) is not None for name in self.programs)


GCC = Compiled("C, gcc", "gcc")
CLANG = Compiled("C, clang", "clang")
AARCH64 = Compiled(
    "C, gcc, aarch64", "aarch64-linux-gnu-gcc", ("-static",), ("qemu-aarch64-static",)
)
WITHOUT_LIBRARIES = (
    "-mbulk-memory",
    "-msimd128",
    "-nostdlib",
    "-nostdlibinc",
    "-isystem",
    str(BROWSER / "include"),
)
WASM = Compiled(
    "C, clang to WebAssembly, in Node",
    "clang",
    ("--target=wasm32", *WITHOUT_LIBRARIES, "-Wl,--no-entry"),
    ("node", str(C / "rows.mjs")),
    BROWSER / "hand.c",
    (),
    ("wasm-ld",),
)
ZIG = (
    "-target",
    "wasm32-freestanding",
    "-mcpu=generic+bulk_memory+simd128",
    *WITHOUT_LIBRARIES[2:],
    "-Wl,--no-entry",
)


def for_a_browser() -> Compiled:
    """What compiles to WebAssembly: the compiler that `make browser` has fetched, else clang."""
    fetched = sorted(ROOT.glob(".venv-browser/lib/*/site-packages/ziglang/zig"))
    if not fetched:
        return WASM
    return replace(WASM, compiler=str(fetched[0]), first=("cc",), flags=ZIG, also=())


SINGLE_GCC = Compiled("C, gcc, single precision", "gcc", SINGLE)


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
    require(*one.programs)
    real = np.float32 if one.flags == SINGLE else np.float64
    rows = stream.written(work / "stream.bin", real)
    program = compiled(one, sources, one.main, work / "rows")
    done = called([*one.runner, program, rows, str(passes)], work)
    answers = np.frombuffer(done.stdout, np.uint8).reshape(len(stream.values), -1)
    labels = np.ascontiguousarray(answers[:, :4]).view(np.int32)[:, 0]
    return StreamAnswers(labels, answers, float(done.stderr))


def golden_of(one: Compiled, sources: Path, work: Path) -> str:
    """What the self-test of a C form prints."""
    program = compiled(one, sources, sources / "holdfast_selftest.c", work / "selftest")
    return called([*one.runner, program], work).stdout.decode().strip()


def compiled(one: Compiled, sources: Path, main: Path, program: Path) -> Path:
    """The program of a C form and a file with a main."""
    words = [one.compiler, *one.first, *FLAGS, *one.flags, f"-I{sources}"]
    files = [sources / "holdfast.c", main]
    called([*words, "-o", program, *files, *one.linked], program.parent)
    return program
