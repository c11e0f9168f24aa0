"""Model files on emulated Arm processors, in C: aarch64, and a Cortex-M7.

On the board QEMU counts instructions, not cycles: times
at 480 MHz are a projection with one instruction a cycle. A real M7 issues up to two, and waits for
its flash.
"""

from __future__ import annotations

import re
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path

from benchmarks.runtimes.c_programs import (
    AARCH64,
    GCC,
    SINGLE,
    SINGLE_GCC,
    C,
    answers_of,
    golden_of,
)
from benchmarks.runtimes.here import same_bits
from benchmarks.runtimes.programs import called, require
from benchmarks.runtimes.stream import stream_of
from holdfast.cli.command import show
from holdfast.core.contract import Json
from holdfast.core.errors import HoldfastError
from holdfast.edge_runtime.model import Model
from holdfast.export.c.exporting import export_c

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


def measure(models: list[Path]) -> Json:
    """Everything that `make bench NAME=arm` shows."""
    return {"clock_mhz": CLOCK_MHZ, "models": [of_model(path) for path in models]}


def of_model(path: Path) -> Json:
    """One file: as C on aarch64, and on the board in both precisions."""
    show(f"{path}: C on aarch64, and on a Cortex-M7")
    model = Model(path)
    stream = stream_of(model)
    with tempfile.TemporaryDirectory() as name:
        work = Path(name)
        export_c(path, work / "c")
        x86, arm, single = (
            answers_of(one, work / "c", stream, work, passes=1)
            for one in (GCC, AARCH64, SINGLE_GCC)
        )
        boards = [on_board(work / "c", precision, work) for precision in PRECISIONS]
        golden = golden_of(AARCH64, work / "c", work)
    differ = {"double": x86, "single": single}
    rows = []
    for one in boards:
        answers = differ[one.precision]
        labels_differ = int((answers.labels != stream.labels).sum())
        row = {**asdict(one), "projected_us": one.projected_us}
        rows.append({**row, "stream_labels_differ": labels_differ})
    return {
        "model": path.stem,
        "rows": len(stream.labels),
        "aarch64_golden": golden,
        "aarch64_labels_differ": int((arm.labels != stream.labels).sum()),
        "aarch64_same_bits": same_bits(arm, x86),
        "boards": rows,
    }


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
