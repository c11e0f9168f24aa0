"""What a set holds, as a short text table."""

from __future__ import annotations

import numpy as np

from training.recording import DataSet


def windows_table(data: DataSet) -> str:
    """Windows by class, one block a task; sets in the thesis' layout show object x action too."""
    if "table" in data.notes:
        natural = ", ".join(
            f"{name} {count}" for name, count in data.notes["windows_natural"].items()
        )
        return f"{data.notes['table']}\n\nall windows before balancing: {natural}"
    lines = []
    for task, rows in data.tasks.items():
        counts = np.bincount(rows.label, minlength=len(rows.classes))
        cells = ", ".join(
            f"{name} {count:,}" for name, count in zip(rows.classes, counts, strict=True)
        )
        lines.append(f"{task}: {len(rows):,} windows ({cells})")
    return "\n".join(lines)
