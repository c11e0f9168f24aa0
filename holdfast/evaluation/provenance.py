"""What figures were measured on: host and versions; and the files of a measurement."""

from __future__ import annotations

import json
import os
import platform
from dataclasses import asdict, dataclass
from importlib.metadata import version
from pathlib import Path

from holdfast.core.contract import Json
from holdfast.core.writing import write_whole
from holdfast.evaluation.formats import markdown

LIBRARIES = ("numpy", "scipy", "scikit-learn", "onnx", "onnxruntime", "skl2onnx")
SEED = 0
"""All measures use fixed seeds."""


@dataclass(frozen=True)
class Host:
    """A machine. machine: its instruction set. cpus: logical ones, None where not known."""

    machine: str
    system: str
    cpus: int | None


def host() -> Host:
    """This machine."""
    return Host(platform.machine(), platform.system(), os.cpu_count())


def write_measured(
    out: Path, what: str, kind: str, figures: Json, picture: str | None
) -> list[str]:
    """Write WHAT.json, with the machine, and WHAT.svg; returns their names and broken budgets.

    picture: SVG, None where the measurement has none.
    """
    # A figure of time means nothing without its machine.
    text = json.dumps(figures | machine_facts(kind), indent=2) + "\n"
    path = write_whole(out / f"{what}.json", text)
    lines = [f"{path}"]
    if picture is not None:
        lines.append(f"{write_whole(path.with_suffix('.svg'), picture)}")
    return lines + [f"over budget: {line}" for line in figures.get("broken", [])]


def table_lines(figures: Json) -> list[str]:
    """The tables among the figures as lines for people; nested figures are only in the JSON."""
    lines = []
    for title, rows in figures.items():
        # Rows that hold a table of their own (latencies by stage) are left to the JSON.
        is_table = isinstance(rows, list) and rows and isinstance(rows[0], dict)
        if is_table and "latency_us" not in rows[0]:
            lines.append(f"{title}\n{markdown(rows)}\n")
    return lines


def machine_facts(kind: str) -> Json:
    """Where and with what it was measured. kind: of the data."""
    versions = {"python": platform.python_version()}
    for name in LIBRARIES:
        versions[name] = version(name)
    machine = {**asdict(host()), "cpu": _processor()}
    return {"kind": kind, "seed": SEED, "host": machine, "versions": versions}


def _processor() -> str | None:
    """The processor's name, None where the system does not have it."""
    try:
        # Other systems than Linux have no such file.
        text = Path("/proc/cpuinfo").read_text("utf-8")
    except OSError:
        return None

    for line in text.splitlines():
        if line.startswith("model name"):
            return line.partition(":")[2].strip()

    return None
