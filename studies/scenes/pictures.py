"""The figures of the study of scenes as the pictures of its report."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from holdfast.core.contract import CLASSES
from holdfast.evaluation.stream_pictures import labelled
from holdfast.evaluation.style import (
    FINGER_COLOURS,
    GRID,
    INK,
    OURS,
    QUIET,
    WARNING,
    svg,
)
from holdfast.evaluation.window_scores import ClassScores, LevelScores
from holdfast.training.figures import ABSENT
from studies.bars import bar, bars
from studies.row_names import row_class, shown
from studies.scenes.figures import RateFigures, Rows, scores_of

METHOD_COLOURS = (OURS, QUIET, WARNING)


def level_bars(rows: Rows, kind: str) -> str:
    """Accuracy of eight and seven classes, and macro F1 of four situations, of every row that
    answers with classes."""
    drawn = {name: row for name, row in rows.items() if isinstance(row, ClassScores)}
    eight = []
    seven = []
    four = []
    for name, row in drawn.items():
        of_class = row_class(name)
        eight.append(bar(row.eight.accuracy, row.eight.accuracy_ci, of_class))
        seven.append(bar(row.seven.accuracy, row.seven.accuracy_ci, of_class))
        four.append(bar(row.four.macro_f1, row.four.macro_f1_ci, of_class))
    with labelled(kind, 9.2, 0.5 * len(drawn) + 1.1) as figure:
        left, middle, right = figure.subplots(1, 3, sharey=True)
        bars(left, eight, "accuracy, eight classes", 0.2)
        bars(middle, seven, "accuracy, nothing as one", 0.2)
        bars(right, four, "macro F1, four situations", 0.2)
        for axes in (left, middle, right):
            axes.set_xlim(right=1.0)
        # more is out of reach: no signal tells the weight while nothing is held
        left.axvline(0.875, color=WARNING, linewidth=0.8, linestyle=":")
        names = [shown(name).replace(", ", ",\n", 1) for name in drawn]
        left.set_yticks(range(len(drawn)), names)
        left.set_ylim(len(drawn) - 0.5, -0.6)
        return svg(figure)


def confusion_spread(matrices: list[Any], kind: str) -> str:
    """Mean confusion of the retrainings with half their range, and the recall of each."""
    shares = np.array(
        [
            np.asarray(m) / np.maximum(np.sum(m, axis=1, keepdims=True), 1)
            for m in matrices
        ]
    )
    mean = shares.mean(axis=0)
    half = np.ptp(shares, axis=0) / 2.0
    names = [name.replace("_", " ") for name in CLASSES]
    with labelled(kind, 9.2, 4.9) as figure:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3.4, 1))
        left.imshow(mean, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(mean):
            _cell(
                left,
                row,
                column,
                value,
                half[row, column] if len(matrices) > 1 else None,
            )
        left.set_xticks(range(len(names)), names, rotation=25, ha="right")
        left.set_yticks(range(len(names)), names)
        left.set(xlabel="answered", ylabel="was")
        left.spines[:].set_visible(False)
        absent = np.sum(matrices, axis=(0, 2)) == 0
        for row in np.flatnonzero(absent).tolist():
            left.text(row, row, ABSENT, ha="center", va="center", fontsize=9)
        for one in shares:
            right.plot(
                np.where(absent, np.nan, np.diagonal(one)),
                range(len(names)),
                "o",
                color=OURS,
                markersize=5,
                alpha=0.6,
            )
        right.set(xlabel="recall of each\nretraining", xlim=(0, 1))
        right.grid(axis="x", color=GRID)
        return svg(figure)


def _cell(axes: Axes, row: int, column: int, value: float, half: float | None) -> None:
    """A share above half its range over the retrainings; nothing where it rounds to 0."""
    if value < 0.005:
        return
    middle: dict[str, Any] = {
        "ha": "center",
        "va": "center",
        "color": "white" if value > 0.5 else INK,
    }
    up = 0.0 if half is None else 0.13
    axes.text(column, row - up, f"{value:.2f}", fontsize=9, **middle)
    if half is not None:
        axes.text(column, row + 0.25, f"± {half:.2f}", fontsize=6.5, **middle)


def objects_left_out(objects: dict[str, dict[str, ClassScores]], kind: str) -> str:
    """Macro F1 of each object held out, one row an object, one mark a method.

    objects: method -> object -> its scores.
    """
    names = list(next(iter(objects.values())))
    with labelled(kind, 7.2, 0.42 * len(names) + 1.5) as figure:
        axes = figure.subplots()
        for place, (method, figures) in enumerate(objects.items()):
            colour = METHOD_COLOURS[place % 3]
            shift = 0.2 * (place - (len(objects) - 1) / 2)
            for row, name in enumerate(names):
                one = figures[name].four
                at = row + shift
                axes.plot(_edges(one), [at, at], color=colour, linewidth=4, alpha=0.35)
                label = _short(method) if row == 0 else None
                axes.plot(_value(one), at, "o", color=colour, markersize=5, label=label)
        axes.set_yticks(range(len(names)), names)
        axes.set(
            xlabel="macro F1, four situations, unseen object",
            xlim=(0, 1),
            ylim=(len(names) - 0.5, -0.5),
        )
        axes.grid(axis="x", color=GRID)
        axes.legend(
            frameon=False,
            loc="lower center",
            bbox_to_anchor=(0.5, 1.0),
            ncols=3,
            fontsize=8,
        )
        return svg(figure)


def rates(studies: dict[str, RateFigures], kind: str) -> str:
    """Left, every method over the rates, trials held out; right, the first one on unseen sets."""
    hz = [float(one) for one in studies]
    every = list(studies.values())
    methods = [
        name for name, row in every[0].rows.items() if isinstance(row, ClassScores)
    ]
    cards = [
        card for card in every[0].others if all(card in one.others for one in every)
    ]
    with labelled(kind, 9.2, 3.2) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for place, name in enumerate(methods):
            scores = [scores_of(one.rows, name).four for one in every]
            _over(left, hz, scores, METHOD_COLOURS[place % 3], _short(name))
        for card, colour in zip(cards, FINGER_COLOURS[1:], strict=False):
            unseen = [
                scores_of(one.others[card].rows, methods[0]).four for one in every
            ]
            _over(right, hz, unseen, colour, card)
        left.set(
            title="trials held out",
            ylabel="macro F1, four situations",
            xlabel="Hz",
            xticks=hz,
        )
        right.set(title="this model, unseen sets", xlabel="Hz", xticks=hz)
        for axes in (left, right):
            axes.grid(axis="y", color=GRID)
            if axes.get_legend_handles_labels()[0]:
                axes.legend(frameon=False, fontsize=8)
        return svg(figure)


def _over(
    axes: Axes,
    hz: Sequence[float],
    figures: Sequence[LevelScores],
    colour: str,
    label: str,
) -> None:
    low, high = np.array([_edges(one) for one in figures]).T
    axes.fill_between(hz, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.plot(hz, [_value(one) for one in figures], "o-", color=colour, label=label)


def _value(of: LevelScores) -> float:
    """Macro F1, or nothing to draw where it is not defined."""
    return np.nan if of.macro_f1 is None else of.macro_f1


def _edges(of: LevelScores) -> list[float]:
    """The interval, or nothing to draw where one trial alone gives none."""
    return list(of.macro_f1_ci or (np.nan, np.nan))


def _short(name: str) -> str:
    return shown(name).split(",")[0]
