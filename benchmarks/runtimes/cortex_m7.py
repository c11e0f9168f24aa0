"""A C form on an emulated Cortex-M7: does it answer right, what does it take, how long is a step.

QEMU counts instructions, not cycles: times at 480 MHz are a projection with one instruction a
cycle. A real M7 issues up to two, and waits for its flash.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

from benchmarks.runtimes.c_programs import SINGLE, C
from benchmarks.runtimes.programs import called, require
from holdfast.core.errors import HoldfastError

COMPILER = "arm-none-eabi-gcc"
CORE = (
    "-mcpu=cortex-m7",
    "-mthumb",
    "-mfloat-abi=hard",
    "-ffunction-sections",
    "-fdata-sections",
)
FLAGS = ("-std=gnu99", "-O2", "-ffp-contract=off", *CORE)
PRECISIONS = {"double": ("-mfpu=fpv5-d16",), "single": ("-mfpu=fpv5-sp-d16", *SINGLE)}
LINKED = ("-nostartfiles", "--specs=rdimon.specs", "-Wl,--gc-sections")
BOARD = ("qemu-system-arm", "-M", "mps2-an500", "-cpu", "cortex-m7", "-nographic")
COUNTED = ("-icount", "shift=0", "-semihosting", "-kernel")
CLOCK_MHZ = 480
REPORT = re.compile(
    r"golden: (\d+) rows, (\d+) labels differ.*"
    r"steps \d+ instructions (\d+) most (\d+) stack (\d+) state (\d+) out (\d+)",
    re.DOTALL,
)


@dataclass(frozen=True)
class OnBoard:
    """One image. Bytes; instructions of a step, the mean and the most; golden rows and labels.

    flash_bytes: code and tables of the C form alone, without the self-test and the C library.
    ram_bytes: state of one hand, its answers, and the stack of a step.
    """

    precision: str
    rows: int
    labels_differ: int
    flash_bytes: int
    ram_bytes: int
    stack_bytes: int
    instructions: int
    most_instructions: int

    @property
    def projected_us(self) -> float:
        """The longest step at CLOCK_MHZ, were every instruction one cycle."""
        return self.most_instructions / CLOCK_MHZ


def on_board(sources: Path, precision: str, work: Path) -> OnBoard:
    """Replay the golden sequence on the emulated board.

    Raises LibraryMissing without the programs, HoldfastError where one of them fails.
    """
    require(COMPILER, "arm-none-eabi-size", BOARD[0])
    flags: list[str | Path] = [COMPILER, *FLAGS, *PRECISIONS[precision], "-I", sources]
    files = (sources / "holdfast.c", sources / "holdfast_selftest.c", C / "cortex.c")
    objects = [work / f"{file.stem}.o" for file in files]
    for file, made in zip(files, objects, strict=True):
        called([*flags, "-c", "-o", made, file], work)
    led = ("-Wl,--wrap=holdfast_step_valid", "-T", C / "mps2.ld")
    called([*flags, *LINKED, *led, "-o", "image.elf", *objects, "-lm"], work)
    size = called(["arm-none-eabi-size", objects[0]], work).stdout.decode().split()
    printed = called([*BOARD, *COUNTED, "image.elf"], work).stdout.decode(
        "utf-8", "replace"
    )
    return read_report(printed, precision, flash_bytes=int(size[6]) + int(size[7]))


def read_report(printed: str, precision: str, flash_bytes: int) -> OnBoard:
    """What the image printed. Raises HoldfastError where it did not end its report."""
    match = REPORT.search(printed)
    if match is None:
        raise HoldfastError(
            f"the image ended without its report: {printed[-200:]!r}",
            cause="it crashed, or its memory is too small",
        )
    rows, differ, mean, most, stack, state, out = (int(word) for word in match.groups())
    ram_bytes = state + out + stack
    return OnBoard(precision, rows, differ, flash_bytes, ram_bytes, stack, mean, most)
