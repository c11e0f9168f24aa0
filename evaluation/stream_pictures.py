"""The pictures of the scenes' report; every one bears the kind of its data ("simulated"). Colours:
Okabe & Ito."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

import matplotlib as mpl
import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from edge_runtime.contract import CLASSES, NORMAL_AXIS, RISKY_SLIP, SITUATIONS, FloatArray
from edge_runtime.decision import UNKNOWN
from evaluation.streams import StreamPicture
from evaluation.style import (
    FINGER_COLOURS,
    INK,
    OURS,
    QUIET,
    SITUATION_COLOURS,
    STYLE,
    WARNING,
    bars,
    svg,
)

FINGERS = ("thumb 1", "thumb 2", "index", "middle", "ring", "little")
LINE_COLOURS = (OURS, QUIET, WARNING)
AROUND_S = (-0.35, 0.65)
"""The second column shows so long before and after the action's first sign."""
EVENT_NAMES = {"load_onset_s": "load", "gross_slip_s": "gross slip", "contact_lost_s": "lost"}


@contextmanager
def labelled(kind: str, width: float, height: float) -> Iterator[Figure]:
    """A figure in our style that says of what kind its data are."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        figure.suptitle(kind, x=0.995, ha="right", fontsize=8, color=WARNING, style="italic")
        yield figure


def score_bars(rows: dict[str, Any], kind: str) -> str:
    """Eight and seven classes and four situations of every line that answers with classes."""
    told = {name: row for name, row in rows.items() if "eight" in row}
    with labelled(kind, 9.2, 0.5 * len(told) + 1.1) as figure:
        eight, seven, four = figure.subplots(1, 3, sharey=True)
        bars(eight, told, "eight", "accuracy", "accuracy, eight classes", 0.2)
        bars(seven, told, "seven", "accuracy", "accuracy, nothing as one", 0.2)
        bars(four, told, "four", "macro_f1", "macro F1, four situations", 0.2)
        for axes in (eight, seven, four):
            axes.set_xlim(right=1.0)
        eight.axvline(0.875, color=WARNING, linewidth=0.8, linestyle=":")
        names = [name.replace("WARNING: ", "warning: ").replace(", ", ",\n", 1) for name in told]
        eight.set_yticks(range(len(told)), names)
        eight.set_ylim(len(told) - 0.5, -0.6)
        return svg(figure)


def confusion_spread(matrices: list[Any], kind: str) -> str:
    """Mean of the retrainings' confusion matrices with half their range, and every retraining's
    recall."""
    shares = np.array(
        [np.asarray(m) / np.maximum(np.sum(m, axis=1, keepdims=True), 1) for m in matrices]
    )
    mean, half = shares.mean(axis=0), np.ptp(shares, axis=0) / 2.0
    names = [name.replace("_", " ") for name in CLASSES]
    with labelled(kind, 9.2, 4.9) as figure:
        left, right = figure.subplots(1, 2, sharey=True, width_ratios=(3.4, 1))
        left.imshow(mean, cmap="Blues", vmin=0, vmax=1, aspect="auto")
        for (row, column), value in np.ndenumerate(mean):
            _cell(left, row, column, value, half[row, column] if len(matrices) > 1 else None)
        left.set_xticks(range(len(names)), names, rotation=25, ha="right")
        left.set_yticks(range(len(names)), names)
        left.set(xlabel="answered", ylabel="was")
        left.spines[:].set_visible(False)
        for one in shares:
            right.plot(
                np.diagonal(one), range(len(names)), "o", color=OURS, markersize=5, alpha=0.6
            )
        right.set(xlabel="recall of each\nretraining", xlim=(0, 1))
        right.grid(axis="x", color="#e4e7eb")
        return svg(figure)


def _cell(axes: Axes, row: int, column: int, value: float, half: float | None) -> None:
    """A share, and below it half the range over the retrainings; cells that round to nothing stay
    empty."""
    if value < 0.005:
        return
    colour = "white" if value > 0.5 else INK
    up = 0.0 if half is None else 0.13
    axes.text(column, row - up, f"{value:.2f}", ha="center", va="center", color=colour, fontsize=9)
    if half is not None:
        axes.text(
            column,
            row + 0.25,
            f"± {half:.2f}",
            ha="center",
            va="center",
            color=colour,
            fontsize=6.5,
        )


def by_object(objects: dict[str, dict[str, Any]], kind: str) -> str:
    """Macro F1 over the situations of each object held out, one row an object, one mark a line of
    the table."""
    names = list(next(iter(objects.values())))
    with labelled(kind, 7.2, 0.42 * len(names) + 1.5) as figure:
        axes = figure.subplots()
        for place, (line, figures) in enumerate(objects.items()):
            colour, shift = LINE_COLOURS[place % 3], 0.2 * (place - (len(objects) - 1) / 2)
            for row, name in enumerate(names):
                one = figures[name]["four"]
                axes.plot(_edges(one), [row + shift] * 2, color=colour, linewidth=4, alpha=0.35)
                label = _short(line) if row == 0 else None
                axes.plot(
                    one["macro_f1"], row + shift, "o", color=colour, markersize=5, label=label
                )
        axes.set_yticks(range(len(names)), names)
        axes.set(
            xlabel="macro F1, four situations, object never met",
            xlim=(0, 1),
            ylim=(len(names) - 0.5, -0.5),
        )
        axes.grid(axis="x", color="#e4e7eb")
        axes.legend(
            frameon=False, loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=3, fontsize=8
        )
        return svg(figure)


def over_rates(rates: dict[str, Any], kind: str) -> str:
    """Left every line of the table over the rates, right ours on sets it never met."""
    hz = [float(rate) for rate in rates]
    studies = list(rates.values())
    with labelled(kind, 9.2, 3.2) as figure:
        left, right = figure.subplots(1, 2, sharey=True)
        for place, line in enumerate(
            name for name, row in studies[0]["rows"].items() if "four" in row
        ):
            _over(
                left,
                hz,
                [study["rows"][line]["four"] for study in studies],
                LINE_COLOURS[place % 3],
                _short(line),
            )
        ours = next(iter(studies[0]["rows"]))
        everywhere = [
            card
            for card in studies[0]["others"]
            if all(card in study["others"] for study in studies)
        ]
        for card, colour in zip(everywhere, FINGER_COLOURS[1:], strict=False):
            _over(
                right,
                hz,
                [study["others"][card]["rows"][ours]["four"] for study in studies],
                colour,
                card,
            )
        left.set(
            title="trials held out", ylabel="macro F1, four situations", xlabel="Hz", xticks=hz
        )
        right.set(title="ours, on what it never met", xlabel="Hz", xticks=hz)
        for axes in (left, right):
            axes.grid(axis="y", color="#e4e7eb")
            if axes.get_legend_handles_labels()[0]:
                axes.legend(frameon=False, fontsize=8)
        return svg(figure)


def _over(
    axes: Axes, hz: list[float], figures: list[dict[str, Any]], colour: str, label: str
) -> None:
    low, high = np.array([_edges(one) for one in figures]).T
    axes.fill_between(hz, low, high, color=colour, alpha=0.15, linewidth=0)
    axes.plot(hz, [one["macro_f1"] for one in figures], "o-", color=colour, label=label)


def _edges(figure: dict[str, Any]) -> list[float]:
    """The interval, or nothing to draw where one trial alone gives none."""
    return figure["macro_f1_ci"] or [np.nan, np.nan]


def _short(line: str) -> str:
    return line.replace("WARNING: a ", "warning: ").split(",")[0]


def stream(picture: StreamPicture, kind: str) -> str:
    """Forces of six fingers with the critical points, and the decision over the truth; right, the
    action alone."""
    recording = picture.recording
    t_s = np.arange(len(recording.samples)) / recording.rate_hz
    forces = recording.samples.reshape(len(t_s), -1, 3)
    shear_n = np.hypot(forces[..., 0], forces[..., 1])
    with labelled(kind, 10.4, 5.6) as figure:
        grid = figure.subplots(
            3, 2, sharex="col", sharey="row", width_ratios=(2.1, 1), height_ratios=(1.2, 1.2, 1)
        )
        for column in range(2):
            _forces(grid[0, column], t_s, forces[..., NORMAL_AXIS], picture)
            _forces(grid[1, column], t_s, shear_n, picture)
            _decision(grid[2, column], t_s, picture)
            grid[2, column].set_xlabel("time in the trial, s")
        for axes, name in zip(grid[:, 0], ("normal, N", "shear, N", ""), strict=True):
            axes.set_ylabel(name)
        grid[0, 1].set_xlim(*_around(picture, t_s))
        grid[0, 0].set_xlim(0.0, t_s[-1])
        _name_events(grid[0, 1], picture)
        grid[0, 0].legend(
            frameon=False, fontsize=7, ncols=6, loc="lower left", bbox_to_anchor=(0.0, 1.0)
        )
        return svg(figure)


def _forces(axes: Axes, t_s: FloatArray, force_n: FloatArray, picture: StreamPicture) -> None:
    """One line a finger; dotted, the labeller's critical points; dashed, the truth's events."""
    for finger, colour in enumerate(FINGER_COLOURS[: force_n.shape[1]]):
        axes.plot(t_s, force_n[:, finger], color=colour, linewidth=0.9, label=FINGERS[finger])
    for point in picture.points:
        axes.axvline(point.t_s, color=INK, linewidth=0.9, linestyle=":")
    for name in EVENT_NAMES:
        if name in picture.events:
            axes.axvline(picture.events[name], color=QUIET, linewidth=0.8, linestyle="--")


def _decision(axes: Axes, t_s: FloatArray, picture: StreamPicture) -> None:
    """Behind, the truth in pale colour from edge to edge; in front, the answer in full colour at
    its own height."""
    step_s = float(t_s[1] - t_s[0])
    for phase in picture.phases:
        axes.axvspan(
            phase.first * step_s,
            phase.stop * step_s,
            color=SITUATION_COLOURS[phase.situation],
            alpha=0.35,
            linewidth=0,
        )
    for situation, colour in enumerate(SITUATION_COLOURS):
        spans = [
            (first * step_s, (stop - first) * step_s)
            for first, stop in runs(picture.answer == situation)
        ]
        axes.broken_barh(
            spans, (situation - 0.32, 0.64), color=colour, edgecolor=INK, linewidth=0.4
        )
    unknown = [
        (first * step_s, (stop - first) * step_s) for first, stop in runs(picture.answer == UNKNOWN)
    ]
    axes.broken_barh(
        unknown, (-0.32, 0.64), facecolor="white", edgecolor=QUIET, linewidth=0.6, hatch="////"
    )
    for first, _ in runs(picture.acts):
        axes.plot(first * step_s, RISKY_SLIP + 0.62, "v", color=INK, markersize=6)
    axes.set_yticks(range(len(SITUATIONS)), [name.replace("_", " ") for name in SITUATIONS])
    axes.set_ylim(-0.5, len(SITUATIONS))


def runs(there: np.ndarray) -> list[tuple[int, int]]:
    """[T] flags -> runs [first, stop).

    >>> runs(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    change = np.diff(there.astype(np.int8), prepend=0, append=0)
    starts, stops = np.flatnonzero(change == 1).tolist(), np.flatnonzero(change == -1).tolist()
    return list(zip(starts, stops, strict=True))


def _around(picture: StreamPicture, t_s: FloatArray) -> tuple[float, float]:
    """The time around the action: its load onset, else the start of the first slip of the truth."""
    slips = [phase.first for phase in picture.phases if phase.situation >= 2]
    at_s = picture.events.get(
        "load_onset_s", float(t_s[slips[0]]) if slips else float(t_s[-1]) / 2.0
    )
    return at_s + AROUND_S[0], at_s + AROUND_S[1]


def _name_events(axes: Axes, picture: StreamPicture) -> None:
    """Names above the dashed lines, each a little higher than the one before, since they stand
    close."""
    low, high = axes.get_xlim()
    shown = [
        (picture.events[key], name) for key, name in EVENT_NAMES.items() if key in picture.events
    ]
    for place, (at_s, name) in enumerate(shown):
        if low < at_s < high:
            axes.annotate(
                name,
                (at_s, 1.0),
                (2, 1 + 8 * place),
                xycoords=("data", "axes fraction"),
                textcoords="offset points",
                fontsize=7,
                color="#52606d",
            )
