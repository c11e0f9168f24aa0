"""The tables of docs/camera.md, from what `holdfast bench onset` measured: `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

from holdfast.core.reading import Json
from tools.doc_tables import Tables, refresh, table

ERROR_HEADS = {
    "fps": "frames per s",
    "found": "detected onsets",
    "hidden": "hidden",
    "start": "start error, ms",
    "seen": "first-seen error, ms",
    "gross": "gross error, ms",
    "start_worst_ms": "largest start error, ms",
}
PULL_HEADS = ERROR_HEADS | {"within_10_ms": "share of starts within 10 ms"}
RAMP_HEADS = {"fps": "frames per s", "mm_per_s2": "acceleration, mm/s2"} | ERROR_HEADS
HELD_HEADS = {
    "n": "holds",
    "elastic_shear_mm": "elastic shear, mm",
    "gross_mm": "gross distance, mm",
    "onsets": "detected onsets",
}


def tables(figures: Json) -> Tables:
    """Every table by its marker."""
    return {
        "ramps": table([_errors(row) for row in figures["ramps"]], RAMP_HEADS),
        "pulls": table([_errors(row) for row in figures["pulls"]], PULL_HEADS),
        "held": table(figures["held"], HELD_HEADS),
    }


def _errors(row: Json) -> Json:
    """A row with the percentiles of each error in one cell."""
    spread = {
        name: " / ".join(f"{row[f'{name}_p{q}_ms']:.1f}" for q in (5, 50, 95))
        for name in ("start", "seen", "gross")
    }
    counts = {"found": f"{row['found']} of {row['n']}"}
    return row | spread | counts | {"start_worst_ms": f"{row['start_worst_ms']:.1f}"}


if __name__ == "__main__":
    refresh(sys.argv[2], {Path(sys.argv[1]): tables})
