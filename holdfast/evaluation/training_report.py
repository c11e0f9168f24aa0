"""The report of a training run: the held-out figure, its parts, and the learning curve."""

from __future__ import annotations

from pathlib import Path

from holdfast.core.errors import count_of
from holdfast.evaluation.html import write_page
from holdfast.evaluation.stream_pictures import labelled
from holdfast.evaluation.style import svg
from holdfast.training.figures import PLURAL, Interval, in_words
from holdfast.training.fitting import Trained
from holdfast.training.judging import CurvePoint, per_doubling
from holdfast.training.recording import DataSet


def write_training_report(
    path: Path, data: DataSet, trained: Trained, artifact: Path
) -> Path:
    """Write the report; OutputError where that cannot be done."""
    figures = trained.figures
    points = trained.curve
    kind = figures.group_kind
    # A joined set may be held out by several kinds.
    groups = PLURAL.get(kind, "groups")
    n_groups = count_of(figures.n_groups, "group")
    if kind in PLURAL:
        n_groups = in_words(figures.n_groups, kind)

    curve = ""
    if trained.curve:
        curve = _curve(points, data.kind, groups)

    return write_page(
        path,
        "training.html",
        data=data,
        figures=figures,
        situations=figures.situations,
        untold=trained.cannot_tell,
        held_out_by=kind,
        not_held_out=trained.not_held_out,
        groups=groups,
        n_groups=n_groups,
        curve=curve,
        points=points,
        gain=per_doubling(points),
        artifact=artifact,
    )


def _curve(points: list[CurvePoint], kind: str, groups: str) -> str:
    """Held-out macro F1 by the training data, with intervals."""
    with labelled(kind, 5.2, 3.0) as figure:
        axes = figure.subplots()
        x, y = [], []
        for point in points:
            if point.macro_f1 is None:
                continue
            x.append(point.n_trials)
            y.append(point.macro_f1)
            low, high = _ends(point.macro_f1_ci, point.macro_f1)
            axes.plot([point.n_trials] * 2, [low, high], color="#0072b2", alpha=0.4)
        axes.plot(x, y, "o-", color="#0072b2", markersize=4)
        axes.set(xlabel=f"trials of the {groups}", ylabel="macro F1, held out")
        axes.set_ylim(0.0, 1.02)
        return svg(figure)


def _ends(interval: Interval | None, value: float) -> Interval:
    """An interval, or the value itself where there is none."""
    return interval or (value, value)
