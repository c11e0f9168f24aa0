"""The pictures of an evaluation; every one shows the kind of its data."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.axes import Axes

from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.figures import TimesMs
from holdfast.evaluation.states import CalibrationBin, ConfusionFigures
from holdfast.evaluation.stream_pictures import ShownTrial, labelled, runs
from holdfast.evaluation.style import INK, QUIET, SITUATION_COLOURS, svg
from holdfast.training.figures import ABSENT

CURVES = (
    ("to_state", "to the first risky_slip state", "#56b4e9", "-", 3.6),
    ("to_act", "to act", "#d55e00", "-", 1.2),
    ("available", "lead available", "#009e73", "--", 1.2),
    ("left", "lead left at act", "#000000", "-", 1.2),
)
"""Field of TimesMs, its name, its colour, line and width. The first is wide: the second often lies
on it."""
SET_COLOURS = (
    "#d55e00",
    "#0072b2",
    "#009e73",
    "#cc79a7",
    "#000000",
    "#e69f00",
    "#56b4e9",
    "#999999",
)
MOST_MS = 150.0
LEAST_EVENTS = 5
"""Fewer make no distribution."""
COLUMNS = 3


def timelines(rows: Sequence[ShownTrial], kind: str) -> str:
    """One row a trial: the truth behind, the state in front, a triangle where the hand acts."""
    with labelled(kind, 10.2, 0.36 * len(rows) + 0.75) as figure:
        axes = figure.subplots()
        for place, row in enumerate(rows):
            _timeline(axes, place, row)
        axes.set_yticks(range(len(rows)), [_name(row) for row in rows], fontsize=7.5)
        axes.set_ylim(len(rows) - 0.45, -0.65)
        axes.set_xlim(
            0.0, max(len(row.situation) / row.trial.recording.rate_hz for row in rows)
        )
        axes.set_xlabel("time in the trial, s")
        axes.spines[:].set_visible(False)
        return svg(figure)


def _name(row: ShownTrial) -> str:
    recording = row.trial.recording
    return f"{recording.object_name} {recording.trial_id.rsplit('_', 1)[-1]}"


def _timeline(axes: Axes, place: int, row: ShownTrial) -> None:
    step_s = 1.0 / row.trial.recording.rate_hz
    for phase in row.trial.recording.phases:
        span = [(phase.first * step_s, (phase.stop - phase.first) * step_s)]
        axes.broken_barh(
            span,
            (place - 0.42, 0.84),
            color=SITUATION_COLOURS[phase.situation],
            alpha=0.38,
            linewidth=0,
        )
    for situation, colour in enumerate(SITUATION_COLOURS):
        axes.broken_barh(
            _spans(row.situation == situation, step_s),
            (place - 0.2, 0.4),
            color=colour,
            linewidth=0,
        )
    unknown = _spans(row.situation == UNKNOWN, step_s)
    axes.broken_barh(
        unknown,
        (place - 0.2, 0.4),
        facecolor="white",
        edgecolor=QUIET,
        linewidth=0.5,
        hatch="////",
    )
    first = [span[0] for span in _spans(row.requests, step_s)]
    axes.plot(
        first,
        [place - 0.46] * len(first),
        "v",
        color=INK,
        markersize=4.5,
        clip_on=False,
    )


def _spans(there: Any, step_s: float) -> list[tuple[float, float]]:
    return [(first * step_s, (stop - first) * step_s) for first, stop in runs(there)]


def distributions(times: dict[str, TimesMs], kind: str) -> str:
    """Share of the detected events by delay and lead in ms, one panel a set."""
    times = {
        name: one for name, one in times.items() if len(one.to_act) >= LEAST_EVENTS
    }
    if not times:
        return ""
    tall = -(-len(times) // COLUMNS)
    with labelled(kind, 10.2, 2.35 * tall + 0.3) as figure:
        panels = figure.subplots(tall, COLUMNS, squeeze=False, sharey=True)
        for axes, (name, one) in zip(panels.flat, times.items(), strict=False):
            for field, title, colour, style, width in CURVES:
                _curve(
                    axes,
                    getattr(one, field),
                    title,
                    color=colour,
                    linestyle=style,
                    linewidth=width,
                )
            axes.set_title(name, fontsize=9, loc="left")
            axes.set(xlim=(-20.0, MOST_MS), ylim=(0.0, 1.02), xlabel="ms")
            axes.axvline(0.0, color=QUIET, linewidth=0.7)
        for axes in list(panels.flat)[len(times) :]:
            axes.set_visible(False)
        panels[0, 0].set_ylabel("share of detected events")
        panels[0, 0].legend(frameon=False, fontsize=7, loc="lower right")
        return svg(figure)


def _curve(axes: Axes, values: Sequence[float], title: str, **look: Any) -> None:
    if values:
        share = np.arange(1, len(values) + 1) / len(values)
        axes.step(np.sort(values), share, where="post", label=title, **look)


def confusion(level: ConfusionFigures, kind: str) -> str:
    """Share of each class' samples by answer; empty where it is about 0, "-" in an absent class."""
    counts = np.asarray(level.counts, dtype=float)
    windows = counts.sum(axis=1, keepdims=True)
    shares = counts / np.maximum(windows, 1.0)
    names = [name.replace("_", " ") for name in level.classes]
    with labelled(kind, 0.41 * len(names) + 1.3, 0.36 * len(names) + 1.1) as figure:
        axes = figure.subplots()
        axes.imshow(shares, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(shares):
            if value >= 0.005:
                colour = "white" if value > 0.5 else INK
                axes.text(
                    column,
                    row,
                    f"{value:.2f}",
                    ha="center",
                    va="center",
                    color=colour,
                    fontsize=7,
                )
        for row in np.flatnonzero(windows == 0.0).tolist():
            axes.text(row, row, ABSENT, ha="center", va="center", fontsize=7)
        axes.set_xticks(range(len(names)), names, rotation=30, ha="right", fontsize=7.5)
        axes.set_yticks(range(len(names) - 1), names[:-1], fontsize=7.5)
        axes.set(xlabel="answered", ylabel="was")
        axes.spines[:].set_visible(False)
        return svg(figure)


def reliability(sets: dict[str, list[CalibrationBin]], kind: str) -> str:
    """Share of risky slips by the probability that was given, one line a set."""
    with labelled(kind, 4.4, 3.0) as figure:
        axes = figure.subplots()
        axes.plot([0, 1], [0, 1], color=QUIET, linewidth=0.8)
        for place, (name, bins) in enumerate(sets.items()):
            colour = SET_COLOURS[place % len(SET_COLOURS)]
            axes.plot(
                [b.said for b in bins],
                [b.was for b in bins],
                "o-",
                color=colour,
                markersize=3,
                linewidth=1.0,
                label=name,
            )
        axes.set(
            xlabel="probability of a risky slip, as given",
            ylabel="share that was one",
            xlim=(0, 1),
            ylim=(0, 1),
        )
        axes.legend(frameon=False, fontsize=7)
        return svg(figure)
