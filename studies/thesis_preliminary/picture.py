"""The study's picture: every case, the published figure beside ours."""

from __future__ import annotations

from matplotlib.axes import Axes

from holdfast.evaluation.style import INK, OURS, QUIET, WARNING, drawing, svg
from studies.thesis_preliminary.figures import StudiedSet
from studies.thesis_preliminary.published import ACCURACY_PERCENT, LEARNERS

COLOURS = (WARNING, OURS)
"""Simulated, then real."""


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
