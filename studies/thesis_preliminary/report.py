"""The report: our table and the thesis' figures side by side.

The page itself is studies/templates/preliminary.html.
"""

from __future__ import annotations

from pathlib import Path

from matplotlib.axes import Axes

from holdfast.evaluation.style import INK, OURS, QUIET, WARNING, drawing, svg
from studies.report import write_report
from studies.thesis_preliminary.cases import CASES
from studies.thesis_preliminary.figures import PreliminaryStudy, Repeated, StudiedSet
from studies.thesis_preliminary.points import KINDS
from studies.thesis_preliminary.published import (
    ACCURACY_PERCENT,
    LEARNERS,
    SHAPES,
    SOURCE,
)

COLOURS = (WARNING, OURS)
"""Simulated, then real."""
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


def accuracies(sets: list[StudiedSet]) -> str:
    """Accuracy in %: a panel for each published case, a line for each learner, bars of one standard
    deviation."""
    with drawing(9.4, 2.9) as figure:
        panels = figure.subplots(1, len(ACCURACY_PERCENT), sharey=True)
        for panel, (case, published) in zip(
            panels, ACCURACY_PERCENT.items(), strict=True
        ):
            _panel(panel, case, published, sets)
        panels[0].set_yticks(range(len(LEARNERS)), LEARNERS)
        panels[0].invert_yaxis()
        figure.legend(
            *panels[0].get_legend_handles_labels(),
            loc="outside upper left",
            ncols=3,
            frameon=False,
        )
        figure.supxlabel("accuracy, %; dotted: chance", fontsize=9)
        return svg(figure)


def _panel(
    axes: Axes, case: str, published: tuple[float | None, ...], sets: list[StudiedSet]
) -> None:
    chance = 100.0 * sets[0].cases[case].chance
    axes.axvline(chance, color=QUIET, linestyle=":", linewidth=1.0)
    known = [
        (value, place) for place, value in enumerate(published) if value is not None
    ]
    axes.plot(
        *zip(*known, strict=True),
        "D",
        color=INK,
        fillstyle="none",
        markersize=6,
        label="thesis, published",
    )
    for one, colour, shift in zip(sets, COLOURS, (-0.18, 0.18), strict=True):
        scores = [one.cases[case].learners[name].accuracy for name in LEARNERS]
        axes.errorbar(
            [100.0 * score.mean for score in scores],
            [place + shift for place in range(len(LEARNERS))],
            xerr=[100.0 * score.sd for score in scores],
            fmt="o",
            color=colour,
            markersize=4,
            linewidth=1.0,
            label=f"{one.data} ({one.kind.split(',')[0]})",
        )
    axes.set_title(f"case {case}", fontsize=9)
    axes.set_xlim(15.0, 102.0)
