"""The report of one person: adverse events first, then recall, timelines."""

from __future__ import annotations

import json
from pathlib import Path

from holdfast.core.errors import count_of
from holdfast.core.writing import write_whole
from holdfast.evaluation.html import write_page
from holdfast.evaluation.pictures import timelines, trial
from holdfast.sessions.study.console import clock_text
from holdfast.sessions.study.outcome import StudyOutcome

REPORT = "report.html"
FIGURES = "report.json"


def write_report(home: Path, outcome: StudyOutcome) -> Path:
    """Write report.json and report.html of a person; returns the page. Raises OutputError."""
    text = json.dumps(outcome.to_json(), indent=1, allow_nan=False)
    write_whole(home / FIGURES, text + "\n")
    figures = outcome.figures
    cells = {}
    pictures = {}
    central = ""
    if figures is not None:
        # The page is a table of objects by actions.
        cells = {(cell.object, cell.action): cell for cell in figures.cells}
        for action, rows in figures.drawn.items():
            pictures[action] = timelines(rows, figures.kind)
        if figures.central is not None:
            central = trial(figures.central, figures.kind)

    return write_page(
        home / REPORT,
        "participant_report.html",
        outcome=outcome,
        figures=figures,
        # Each object once, in the order of its first trial; the empty hand has no name.
        objects=list(dict.fromkeys(name for name, _ in cells if name)),
        cells=cells,
        pictures=pictures,
        central_picture=central,
        clock=clock_text,
    )


def summary_lines(outcome: StudyOutcome, page: Path) -> list[str]:
    """The outcome as lines for the operator."""
    trials = f"{outcome.kept} of {count_of(outcome.planned, 'trial')} kept"
    lines = [
        f"{outcome.person}: {trials}, {count_of(len(outcome.adverse), 'adverse event')}"
    ]
    figures = outcome.figures

    if figures is None:
        lines.append(f"no figures of a model: {outcome.no_figures}")
    else:
        for one in (*figures.actions, figures.whole):
            lines.append(
                f"  {one.action or 'all'}: {one.recognised} of "
                f"{count_of(one.labelled, 'labelled trial')} recognised, "
                f"{count_of(one.false_alarms, 'false alarm')} in {one.minutes:.1f} min "
                f"({figures.kind})"
            )

    return [*lines, f"report: {page}"]
