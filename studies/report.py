"""Reports of studies from templates in templates/, which build on those of evaluation."""

from __future__ import annotations

from pathlib import Path

from holdfast.evaluation.html import write_page
from holdfast.evaluation.window_scores import ClassScores, LevelScores
from holdfast.training.figures import Interval, over
from studies.row_names import row_class, shown

TEMPLATES = Path(__file__).with_name("templates")
Figure = tuple[float | None, Interval | None]
"""A value and its 95 % interval."""


def edges(interval: Interval | None, joint: str = " to ") -> str:
    """An interval to three places, or that there is none."""
    if interval is None:
        return "no interval"
    return joint.join(f"{edge:.3f}" for edge in interval)


def level_figures(row: ClassScores) -> list[Figure]:
    """Accuracy of eight and seven classes and of four situations, and macro F1 of the four."""
    return [
        (row.eight.accuracy, row.eight.accuracy_ci),
        (row.seven.accuracy, row.seven.accuracy_ci),
        (row.four.accuracy, row.four.accuracy_ci),
        (row.four.macro_f1, row.four.macro_f1_ci),
    ]


def f1_levels(row: object) -> list[LevelScores | None]:
    """The levels whose macro F1 a table shows; none of a threshold, which knows no classes."""
    return [row.four, row.seven] if isinstance(row, ClassScores) else [None, None]


FUNCTIONS = {
    "shown": shown,
    "row_class": row_class,
    "averaged_over": over,
    "edges": edges,
    "level_figures": level_figures,
    "f1_levels": f1_levels,
}
"""What every template of a study may call."""


def write_report(path: Path, template: str, **values: object) -> Path:
    """Write the page of a study; OutputError where that cannot be done."""
    return write_page(path, template, TEMPLATES, **{**FUNCTIONS, **values})
