"""Model files on emulated Arm processors: aarch64 in C and Python, and a Cortex-M7.

The first model is also checked in Python.
"""

from __future__ import annotations

import tempfile
from dataclasses import asdict
from pathlib import Path

from benchmarks.runtimes.aarch64_python import selftest
from benchmarks.runtimes.c_programs import (
    AARCH64,
    GCC,
    SINGLE_GCC,
    answers_of,
    golden_of,
)
from benchmarks.runtimes.cortex_m7 import CLOCK_MHZ, PRECISIONS, on_board
from benchmarks.runtimes.here import same_bits
from benchmarks.runtimes.stream import stream_of
from holdfast.cli.command import show
from holdfast.core.reading import Json
from holdfast.edge_runtime.model import Model
from holdfast.export.c.exporting import export_c

KEPT = Path("build/arm")
"""What was fetched for aarch64."""


def measure(models: list[Path]) -> Json:
    """Everything that `make bench NAME=arm` shows."""
    figures = [of_model(path) for path in models]
    show(f"holdfast selftest {models[0]} on an emulated aarch64: some minutes")
    lines = selftest(models[0], KEPT)
    return {
        "clock_mhz": CLOCK_MHZ,
        "models": figures,
        "selftest": lines,
    }


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
    return {
        "model": path.stem,
        "rows": len(stream.labels),
        "aarch64_golden": golden,
        "aarch64_labels_differ": int((arm.labels != stream.labels).sum()),
        "aarch64_same_bits": same_bits(arm, x86),
        "boards": [
            {
                **asdict(one),
                "projected_us": one.projected_us,
                "stream_labels_differ": int(
                    (differ[one.precision].labels != stream.labels).sum()
                ),
            }
            for one in boards
        ],
    }
