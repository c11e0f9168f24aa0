"""What a set holds, and how its situations are recognised, as short text tables."""

from __future__ import annotations

import numpy as np

from holdfast.edge_runtime.reading import Json
from holdfast.training.figures import ABSENT, Interval, SituationFigures, over
from holdfast.training.hold_out import PLURAL
from holdfast.training.recording import DataSet


def windows_table(data: DataSet) -> str:
    """Windows by class, one block a task; sets in the thesis' layout show object x action too."""
    if "table" in data.notes:
        return "\n\n".join([data.notes["table"], _on_counts(data.notes)])
    lines = []
    for task, rows in data.tasks.items():
        counts = np.bincount(rows.label, minlength=len(rows.classes))
        cells = ", ".join(
            f"{name} {count:,}" for name, count in zip(rows.classes, counts, strict=True)
        )
        lines.append(f"{task}: {len(rows):,} windows ({cells})")
    return "\n".join(lines)


def _on_counts(notes: Json) -> str:
    """What the thesis' set was drawn from; of the others, that counts are no weights."""
    counts = notes.get("windows_natural") or notes["windows"]
    if counts == notes["windows"]:
        return "in training every class weighs the same, whatever its count"
    natural = ", ".join(f"{name} {count}" for name, count in counts.items())
    return f"all windows before undersampling: {natural}"


def situation_lines(of: SituationFigures, group_kind: str) -> list[str]:
    """The macro F1 and what it is over, then the F1 of each situation.

    group_kind: what the intervals resample.
    """
    macro = with_interval(of.macro_f1, of.macro_f1_ci, group_kind)
    return [
        f"macro F1 {over(of.f1) or 'over four situations'}  {macro}",
        *(
            f"  F1 {name:<12} {with_interval(f1, of.f1_ci[name], group_kind)}"
            for name, f1 in of.f1.items()
        ),
    ]


def with_interval(value: float | None, interval: Interval | None, group_kind: str) -> str:
    """A figure and its interval over groups of a kind; "-" where it is not defined."""
    if value is None:
        return ABSENT
    if not interval:
        return f"{value:.3f}"
    groups, (low, high) = PLURAL.get(group_kind, "groups"), interval
    return f"{value:.3f}  (95 % interval over {groups} {low:.3f} to {high:.3f})"
