"""What a process that answers holds in memory, beside one that has only the libraries."""

from __future__ import annotations

import subprocess
import sys
import time
from dataclasses import dataclass
from pathlib import Path

LIBRARIES = (
    "import os; os.environ['ORT_DISABLE_TELEMETRY'] = '1'; import numpy, onnxruntime"
)
LIVE_PATH = """
import sys
import numpy as np
from holdfast.core.contract import Sample
from holdfast.edge_runtime.monitor import GripMonitor, Model
monitor = GripMonitor(Model(sys.argv[1]), None)
card = monitor.card
monitor.feed(Sample(0, np.zeros(card.n_channels), np.ones(card.n_channels // 3, dtype=np.bool_), 0))
"""
MEMORY_KB = """
status = dict(line.split(":", 1) for line in open("/proc/self/status"))
print(status["VmRSS"].split()[0], status["RssAnon"].split()[0])
"""


@dataclass(frozen=True)
class ProcessMemory:
    """A process: its resident memory, what of it is no file's, and the time of start and end."""

    process: str
    resident_mb: float
    own_mb: float
    start_s: float


def memory(model_path: Path) -> list[ProcessMemory]:
    """Two processes: libraries alone, and the live path with a model."""
    rows = []
    for name, program in (
        ("floor", LIBRARIES),
        ("live path, default model", LIVE_PATH),
    ):
        started = time.perf_counter()
        # A fresh process each: memory that was once used is rarely given back.
        command = [sys.executable, "-c", program + MEMORY_KB, str(model_path)]
        done = subprocess.run(command, capture_output=True, text=True, check=True)
        # Start and end together: what a user waits for a program that does nothing else.
        took_s = time.perf_counter() - started

        # The kernel counts in KiB.
        resident_mb, own_mb = (int(word) / 1024 for word in done.stdout.split())
        rows.append(ProcessMemory(name, resident_mb, own_mb, took_s))

    return rows
