"""One self-contained HTML file: the result, the baselines, then how it was made.

The page itself is studies/templates/real.html.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from holdfast.core.contract import SITUATIONS
from holdfast.data.recording import DataSet
from holdfast.training.crossval import HeldOut
from studies.real import pictures
from studies.real.figures import RealStudy, prediction_of
from studies.report import write_report


@dataclass(frozen=True)
class Evidence:
    """Everything the report shows."""

    data: DataSet
    held_out: HeldOut
    figures: RealStudy


def write_real_report(path: Path, evidence: Evidence) -> Path:
    """Write the report; OutputError where that cannot be done."""
    data = evidence.data
    held_out = evidence.held_out
    figures = evidence.figures
    return write_report(
        path,
        "real.html",
        figures=figures,
        heads=figures.heads,
        head=prediction_of(figures.heads),
        prediction_of=prediction_of,
        chance=data.tasks["predict_250ms"].label.mean(),
        table_bars=pictures.table_bars(figures.rows),
        f1_heads=[f"F1 {name.replace('_', ' ')}" for name in SITUATIONS],
        confusion=pictures.confusion(data, held_out),
        by_person=pictures.by_person(data, held_out),
        curves=pictures.curves(data, held_out),
        checked=figures.streamed_fold.verification,
    )
