"""The report's pictures, each one function that returns an SVG to be inlined."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from matplotlib.axes import Axes
from sklearn.metrics import confusion_matrix, precision_recall_curve, roc_curve

from holdfast.core.contract import SITUATIONS
from holdfast.data.metrics import ABSENT, HeadFigures, Interval, situation_scores
from holdfast.data.recording import DataSet
from holdfast.evaluation.style import GRID, INK, OURS, QUIET, WARNING, drawing, svg
from holdfast.training.crossval import HeldOut
from studies.real.figures import prediction_of
from studies.row_names import row_class, shown

ROW_COLOURS = {"ours": OURS, "warning": WARNING, "": QUIET}
"""By the class of a row, as the table of the report has it."""
Bars = Mapping[str, tuple[float | None, Interval | None]]
"""Row -> a figure and its interval; None where they are not defined."""


def table_bars(rows: Mapping[str, HeadFigures]) -> str:
    """Macro F1 and AUC of every row of the table, with intervals over people."""
    with drawing(8.6, 0.42 * len(rows) + 0.9) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        situations = {name: one.situations for name, one in rows.items()}
        f1 = {name: (one.macro_f1, one.macro_f1_ci) for name, one in situations.items()}
        heads = {name: prediction_of(one) for name, one in rows.items()}
        auc = {name: (one.auc, one.auc_ci) for name, one in heads.items()}
        _bars(left, f1, "macro F1, four situations", 0.45)
        _bars(right, auc, "AUC, risky within 0.25 s", 0.5)
        left.set_yticks(range(len(rows)), [shown(name) for name in rows])
        left.invert_yaxis()
        return svg(figure)


def _bars(axes: Axes, rows: Bars, title: str, start: float) -> None:
    """One figure a row with its interval; this model and warnings in colours of their own."""
    for place, (name, (value, interval)) in enumerate(rows.items()):
        if value is None or interval is None:
            continue
        colour = ROW_COLOURS[row_class(name)]
        ends = [place, place]
        axes.plot(interval, ends, color=colour, linewidth=5, alpha=0.35)
        axes.plot(value, place, "o", color=colour, markersize=6)
        axes.annotate(
            f"{value:.3f}",
            (value, place),
            (0, 6),
            textcoords="offset points",
            ha="center",
            fontsize=8,
        )
    axes.set_xlim(left=start)
    axes.set_title(title, fontsize=10, loc="left")
    axes.grid(axis="x", color=GRID)
    axes.set_axisbelow(True)


def confusion(data: DataSet, held_out: HeldOut) -> str:
    """Share of each situation's windows by what was answered."""
    truth = data.tasks["situations"].label
    share = confusion_matrix(
        truth, held_out.situations(), labels=range(4), normalize="true"
    )
    absent = np.bincount(truth, minlength=4) == 0
    with drawing(4.1, 3.4) as figure:
        axes = figure.subplots()
        axes.imshow(share, cmap="Blues", vmin=0, vmax=1)
        for (row, column), value in np.ndenumerate(share):
            axes.text(
                column,
                row,
                ABSENT if absent[row] else f"{value:.2f}",
                ha="center",
                va="center",
                color="white" if value > 0.5 else INK,
            )
        names = [name.replace("_", " ") for name in SITUATIONS]
        axes.set_xticks(range(4), names, rotation=20, ha="right")
        axes.set_yticks(range(4), names)
        axes.set(xlabel="answered", ylabel="was")
        axes.spines[:].set_visible(False)
        return svg(figure)


def curves(data: DataSet, held_out: HeldOut) -> str:
    """ROC and precision-recall of the 0.25 s prediction, held-out people pooled."""
    truth = data.tasks["predict_250ms"].label
    score = held_out.shares("predict_250ms")[:, 1]
    false, hit, _ = roc_curve(truth, score)
    precision, recall, _ = precision_recall_curve(truth, score)
    with drawing(6.4, 3.0) as figure:
        left, right = figure.subplots(1, 2)
        left.plot(false, hit, color=OURS)
        left.plot([0, 1], [0, 1], color=QUIET, linewidth=0.8)
        left.set(
            xlabel="false alarms (share of quiet windows)",
            ylabel="found (share of risky windows)",
        )
        right.plot(recall, precision, color=OURS)
        right.axhline(truth.mean(), color=QUIET, linewidth=0.8)
        right.set(
            xlabel="found (recall)",
            ylabel="right when it speaks (precision)",
            ylim=(0, 1),
        )
        return svg(figure)


def by_person(data: DataSet, held_out: HeldOut) -> str:
    """Macro F1 of every person, sorted: how far people differ."""
    truth = data.tasks["situations"].label
    groups = data.group_of("situations")
    figures = [
        situation_scores(truth[here], held_out.situations()[here], groups[here])
        for here in (groups == name for name in data.groups())
    ]
    ordered = sorted(one.macro_f1 for one in figures if one.macro_f1 is not None)
    with drawing(4.1, 3.0) as figure:
        axes = figure.subplots()
        axes.plot(range(1, len(ordered) + 1), ordered, "o", color=OURS)
        axes.set_xticks(range(1, len(ordered) + 1, 3))
        axes.set(
            xlabel="people, from worst to best",
            ylabel="macro F1 of one person",
            ylim=(0, 1),
        )
        axes.grid(axis="y", color=GRID)
        return svg(figure)
