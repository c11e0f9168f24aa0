"""Reports of studies from templates in templates/, which build on those of evaluation."""

from __future__ import annotations

from pathlib import Path

from holdfast.data.metrics import Interval, over
from holdfast.evaluation.style import write_page
from studies.row_names import row_class, shown

TEMPLATES = Path(__file__).with_name("templates")


def edges(interval: Interval | None, joint: str = " to ") -> str:
    """An interval to three places, or that there is none."""
    if interval is None:
        return "no interval"
    return joint.join(f"{edge:.3f}" for edge in interval)


FUNCTIONS = {
    "shown": shown,
    "row_class": row_class,
    "averaged_over": over,
    "edges": edges,
}
"""What every template of a study may call."""


def write_report(path: Path, template: str, **values: object) -> Path:
    """Write the page of a study; OutputError where that cannot be done."""
    return write_page(path, template, TEMPLATES, **{**FUNCTIONS, **values})
