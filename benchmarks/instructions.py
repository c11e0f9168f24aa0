"""Instructions a call, counted by callgrind: a figure without the machine's noise.

Two runs of a process that differ only in how many calls they make; the difference over the calls is
one call, Python's part of it included. The projection to a board takes its clock and instructions a
cycle: a projection, no measurement.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import onnx

from benchmarks.runtimes.c_programs import GCC, compiled
from benchmarks.runtimes.stream import Stream
from holdfast.core.errors import LibraryMissing
from holdfast.edge_runtime.graph import run_recording
from holdfast.edge_runtime.monitor import Model
from holdfast.evaluation.latency.calls import golden
from holdfast.export.c.exporting import export_c
from holdfast.export.verify import cut_learners

FEW = 10
MANY = 410
C_PASSES = 4
CORTEX_A72_HZ = 1.5e9
INSTRUCTIONS_A_CYCLE = 1.0
"""Assumed for a Cortex-A72 (Raspberry Pi 4): it decodes three at most; code of many small calls
gets about one."""
PROGRAM = """
import sys
from pathlib import Path
import numpy as np
from holdfast.evaluation.latency.calls import learner_of, step_of
from holdfast.edge_runtime.graph import open_session
from holdfast.edge_runtime.monitor import Model
path, rows, calls = Path(sys.argv[1]), sys.argv[2], int(sys.argv[3])
call = learner_of(open_session(path.read_bytes()), np.load(rows)) if rows else step_of(Model(path))
for _ in range(calls):
    call()
"""


@dataclass(frozen=True)
class CallInstructions:
    """Instructions of one call, and its time on a Cortex-A72, us: projected, not measured."""

    what: str
    instructions: float
    projected_cortex_a72_us: float


def instructions(model: Path) -> list[CallInstructions]:
    """One row per call. Raises LibraryMissing without valgrind."""
    if shutil.which("valgrind") is None:
        raise LibraryMissing(
            "no valgrind",
            where="valgrind",
            next_step="install valgrind to count instructions",
        )
    whole = Model(model)
    with tempfile.TemporaryDirectory() as work:
        alone = Path(work) / "learner.onnx"
        rows = Path(work) / "rows.npy"
        alone.write_bytes(cut_learners(onnx.load(model)))
        np.save(
            rows, run_recording(whole.session, *golden(whole), ["features"])["features"]
        )
        return [
            _row("whole step", _called(model, "")),
            _row("learner alone", _called(alone, rows)),
            *_step_in_c(whole, Path(work)),
        ]


def _row(name: str, instructions: float) -> CallInstructions:
    projected_us = 1e6 * instructions / INSTRUCTIONS_A_CYCLE / CORTEX_A72_HZ
    return CallInstructions(name, instructions, projected_us)


def _called(model: Path, rows: Path | str) -> float:
    """Instructions of one call from Python."""
    words = [sys.executable, "-c", PROGRAM, str(model), str(rows)]
    few, many = (_counted([*words, str(calls)]) for calls in (FEW, MANY))
    return (many - few) / (MANY - FEW)


def _step_in_c(model: Model, work: Path) -> list[CallInstructions]:
    """The same step in C, called from C; nothing without gcc."""
    if not GCC.is_installed:
        return []
    export_c(model.path, work / "c")
    program = compiled(GCC, work / "c", GCC.main, work / "rows")
    stream = Stream(*golden(model), labels=np.zeros(0, np.int64))
    words = [str(program), str(stream.written(work / "stream.bin"))]
    few, many = (_counted([*words, str(passes)]) for passes in (1, 1 + C_PASSES))
    return [_row("whole step in C", (many - few) / C_PASSES / len(stream.values))]


def _counted(words: list[str]) -> int:
    with tempfile.TemporaryDirectory() as work:
        valgrind = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={work}/out"]
        ran = subprocess.run(
            [*valgrind, *words],
            capture_output=True,
            text=True,
            errors="replace",
            check=True,
        )
    found = re.search(r"Collected : (\d+)", ran.stderr)
    if found is None:
        raise LibraryMissing(
            "valgrind counted nothing", where="valgrind", cause=ran.stderr[-200:]
        )
    return int(found[1])
