"""What a set holds, as a short text table."""

from __future__ import annotations

import numpy as np

from training.recording import DataSet


def windows_table(data: DataSet) -> str:
    """Windows by class, one block a task; sets in the thesis' layout show object x action too."""
    if "table_balanced" in data.notes:
        return str(data.notes["table_balanced"])
    lines = []
    for task, rows in data.tasks.items():
        counts = np.bincount(rows.label, minlength=len(rows.classes))
        cells = ", ".join(f"{name} {count:,}" for name, count in zip(rows.classes, counts, strict=True))
        lines.append(f"{task}: {len(rows):,} windows ({cells})")
    return "\n".join(lines)
