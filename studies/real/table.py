"""The README's tables of `make real` and `make study NAME=real-more`.

`python -m studies.real.table METRICS ALL-CHANNELS PAGE`
"""

from __future__ import annotations

import sys
from pathlib import Path

from holdfast.core.reading import Json
from holdfast.evaluation.formats import markdown
from studies.row_names import shown
from tools.doc_tables import Tables, refresh

FIGURES = {
    "macro F1, four situations": ("situations", "macro_f1"),
    "AUC, risky within 0.25 s": ("predict_250ms", "auc"),
    "average precision": ("predict_250ms", "average_precision"),
}
"""Column -> task and figure."""


def tables(figures: Json) -> Tables:
    """Every method with its figures, and what was checked in the same run."""
    return {"real": _methods(figures), "real-checks": markdown(_checks(figures))}


def all_channels(figures: Json) -> Tables:
    """The methods on all 48 channels."""
    return {"real-all-channels": _methods(figures)}


def _methods(figures: Json) -> str:
    return markdown([_row(name, row) for name, row in figures["rows"].items()])


def _row(name: str, row: Json) -> dict[str, str]:
    cells = {
        head: _figure(row[task], figure) for head, (task, figure) in FIGURES.items()
    }
    return {"method": shown(name)} | cells


def _figure(row: Json, name: str) -> str:
    low, high = row[f"{name}_ci"]
    return f"{row[name]:.3f} ({low:.3f} to {high:.3f})"


def _checks(figures: Json) -> list[dict[str, str]]:
    checked, cost = figures["verification"], figures["features_cost"]
    differing = f"{checked['label_mismatches']} of {checked['rows']:,}"
    rows = {
        "trials, people": f"{figures['n_trials']}, {figures['n_groups']}",
        "labels in which exported files and scikit-learn differ": differing,
        "features of all samples": f"{cost['samples']:,} samples, {cost['cpu_s']:.1f} CPU s",
        "whole command": f"{figures['seconds']:.0f} s",
    }
    return [
        {"checked in the same run": name, "result": value}
        for name, value in rows.items()
    ]


if __name__ == "__main__":
    metrics, further, page = sys.argv[1:]
    refresh(page, {Path(metrics): tables, Path(further): all_channels})
