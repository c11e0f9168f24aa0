"""The table of docs/live-page.md, from what benchmarks/live_page.py measured: `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

import numpy as np

from holdfast.core.reading import Json
from tools.doc_tables import Tables, refresh, table

HEADS = {
    "case": "watched by",
    "samples": "samples",
    "overruns": "overruns",
    "latency_p999_us": "latency, us",
    "emit_p50_us": "passing on, us",
    "emit_p999_us": "99.9 %, us",
    "disconnects": "disconnects",
    "frames_per_s": "pictures a second",
}
SUMS = ("samples", "overruns", "disconnects")


def tables(figures: Json) -> Tables:
    """Every table by its marker: a row a case, its runs together."""
    cases = dict.fromkeys(row["case"] for row in figures["rows"])
    return {
        "delays": table([_together(figures["rows"], case) for case in cases], HEADS)
    }


def _together(rows: list[Json], case: str) -> Json:
    """Sums of counts and medians of times over the runs of a case."""
    runs = [row for row in rows if row["case"] == case]
    sums = {name: sum(row[name] for row in runs) for name in SUMS}
    rest = [name for name in HEADS if name not in (*SUMS, "case")]
    return {"case": case, **sums} | {name: _median(runs, name) for name in rest}


def _median(runs: list[Json], name: str) -> str | float:
    values = [row[name] for row in runs]
    return "-" if None in values else float(np.median(values))


if __name__ == "__main__":
    refresh(sys.argv[2], {Path(sys.argv[1]): tables})
