"""The report: our table and the thesis' figures side by side.

The page itself is studies/templates/preliminary.html.
"""

from __future__ import annotations

from pathlib import Path

from studies.report import write_report
from studies.thesis_preliminary.cases import CASES
from studies.thesis_preliminary.figures import PreliminaryStudy, Repeated, StudiedSet
from studies.thesis_preliminary.picture import accuracies
from studies.thesis_preliminary.points import KINDS
from studies.thesis_preliminary.published import (
    ACCURACY_PERCENT,
    LEARNERS,
    SHAPES,
    SOURCE,
)

BARE = (LEARNERS[1], LEARNERS[2], LEARNERS[0])
"""Learners on distances, on variances and on the order of values."""


def write_preliminary_report(path: Path, figures: PreliminaryStudy) -> Path:
    """Write the page; OutputError where that cannot be done."""
    return write_report(
        path,
        "preliminary.html",
        figures=figures,
        accuracies=accuracies(figures.sets),
        accuracy_percent=ACCURACY_PERCENT,
        learners=list(LEARNERS),
        shapes=SHAPES,
        source=SOURCE,
        cases=CASES,
        kinds=KINDS,
        bare=BARE,
        bare_heads=[f"{name}: from 2 to 2, bare" for name in BARE],
    )


def summary(figures: PreliminaryStudy) -> list[str]:
    """One line a case: accuracy in % of the random forest, published and ours."""
    lines = ["random forest, accuracy in %, published | ours"]
    for case in CASES:
        published = "-"
        if case.published:
            published = f"{ACCURACY_PERCENT[case.published][0]:.2f}"
        ours = [f"{one.data} {_score(_forest(one, case.name))}" for one in figures.sets]
        lines.append(f"case {case.name}: {published} | {', '.join(ours)}")
    return lines


def _forest(one: StudiedSet, case: str) -> Repeated:
    return one.cases[case].learners[LEARNERS[0]].accuracy


def _score(score: Repeated) -> str:
    return f"{100.0 * score.mean:.1f} ± {100.0 * score.sd:.1f}"
