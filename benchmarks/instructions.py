"""Instructions a call, counted by callgrind: a figure without the machine's noise.

Two runs of a process that differ only in how many calls they make; the difference over the calls is one call, Python's
part of it included. The projection to a board takes its clock and instructions a cycle: a projection, no measurement.
"""

from __future__ import annotations

import re
import shutil
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

from edge_runtime.errors import LibraryMissing

FEW, MANY = 10, 410
CORTEX_A72_HZ = 1.5e9
INSTRUCTIONS_A_CYCLE = 1.0
"""Assumed for a Cortex-A72 (Raspberry Pi 4): it decodes three at most; code of many small calls gets about one."""
WHAT = {"whole step": "benchmarks.latency:step_of", "forest alone": "benchmarks.latency:forests_of"}
PROGRAM = """
import sys
from importlib import import_module
from pathlib import Path
from edge_runtime.monitor import Model
module, _, name = sys.argv[1].partition(":")
call = getattr(import_module(module), name)(Model(Path(sys.argv[2])))
for _ in range(int(sys.argv[3])):
    call()
"""


def instructions(model: Path) -> list[dict[str, Any]]:
    """One row a thing: instructions a call, and the projection in us. Raises LibraryMissing without valgrind."""
    if shutil.which("valgrind") is None:
        raise LibraryMissing("no valgrind", where="valgrind", next_step="install valgrind to count instructions")
    return [_row(name, target, model) for name, target in WHAT.items()]


def _row(name: str, target: str, model: Path) -> dict[str, Any]:
    few, many = (_counted(target, model, calls) for calls in (FEW, MANY))
    each = (many - few) / (MANY - FEW)
    return {
        "what": name, "instructions": each,
        "projected_cortex_a72_us": 1e6 * each / INSTRUCTIONS_A_CYCLE / CORTEX_A72_HZ,
    }  # fmt: skip


def _counted(target: str, model: Path, calls: int) -> int:
    with tempfile.TemporaryDirectory() as work:
        ran = subprocess.run(
            ["valgrind", "--tool=callgrind", f"--callgrind-out-file={work}/out", sys.executable, "-c", PROGRAM,
             target, str(model), str(calls)],
            capture_output=True, text=True, check=True,
        )  # fmt: skip
    found = re.search(r"Collected : (\d+)", ran.stderr)
    if found is None:
        raise LibraryMissing("valgrind counted nothing", where="valgrind", cause=ran.stderr[-200:])
    return int(found[1])
