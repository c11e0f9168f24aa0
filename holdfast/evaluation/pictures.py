"""The pictures of an evaluation; every one shows the kind of its data."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from holdfast.core.contract import NORMAL_AXIS, SAFE_SLIP, BoolArray
from holdfast.data.recording import Recording, runs_of
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.scored_set import SetTimes
from holdfast.evaluation.states import CalibrationBin
from holdfast.evaluation.style import (
    INK,
    OURS,
    QUIET,
    SITUATION_COLOURS,
    WARNING,
    labelled,
    svg,
)
from holdfast.evaluation.trials import AnsweredTrial

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
"""Right end of the distributions, ms, unless most alarms come later."""
LEAST_EVENTS = 5
"""Fewer make no distribution."""
AROUND_S = (-1.0, 0.8)
"""A trial in full is shown from so long before its first slip to so long after it began."""
MOST_SHOWN_S = 20.0
"""Of one without a slip."""
COLUMNS = 3
"""Panels side by side."""
Height = tuple[float, float]
"""Lower edge and height of a bar, in places of the axis."""


def timelines(rows: Sequence[AnsweredTrial], kind: str) -> str:
    """One row a trial: the truth behind, the state in front, a triangle where the hand acts."""
    with labelled(kind, 10.2, 0.36 * len(rows) + 0.75) as figure:
        axes = figure.subplots()
        names = []
        last_s = 0.0
        for place, row in enumerate(rows):
            recording = row.trial.recording
            # Less high than the truth, which shows above and below the answer.
            _draw_truth(axes, recording, (place - 0.42, 0.84), alpha=0.38)
            _draw_answer(axes, row, (place - 0.2, 0.4))
            # Only the begin of each request: that is the moment at which the hand acts.
            for first_s, _ in spans(row.requests, 1.0 / recording.rate_hz):
                mark = (first_s, place - 0.46)
                axes.plot(*mark, "v", color=INK, markersize=4.5, clip_on=False)
            names.append(_row_name(recording))
            # The longest trial decides the width: trials of a picture differ in length.
            last_s = max(last_s, len(row.situation) / recording.rate_hz)

        axes.set_yticks(range(len(rows)), names, fontsize=7.5)
        # The first trial stands on top, as in a table, so the axis points down.
        axes.set_ylim(len(rows) - 0.45, -0.65)
        axes.set_xlim(0.0, last_s)
        axes.set_xlabel("time in the trial, s")
        return svg(figure)


def _row_name(recording: Recording) -> str:
    """A trial on its row: person, object and number, those that the recordings name."""
    number = recording.trial_id.rsplit("_", 1)[-1]
    # Each person has a first trial with a book, so the person stands before it.
    named = [recording.person, recording.object_name, number]
    return " ".join(word for word in named if word)


def _draw_truth(
    axes: Axes, recording: Recording, height: Height, alpha: float = 1.0
) -> None:
    """The labelled phases as a bar, in a colour of this alpha."""
    step_s = 1.0 / recording.rate_hz
    for phase in recording.phases:
        span = (phase.first * step_s, (phase.stop - phase.first) * step_s)
        colour = SITUATION_COLOURS[phase.situation]
        axes.broken_barh([span], height, color=colour, alpha=alpha, linewidth=0)
    axes.spines[:].set_visible(False)


def _draw_answer(axes: Axes, row: AnsweredTrial, height: Height) -> None:
    """The state at every sample as a bar."""
    step_s = 1.0 / row.trial.recording.rate_hz
    for situation, colour in enumerate(SITUATION_COLOURS):
        here = spans(row.situation == situation, step_s)
        axes.broken_barh(here, height, color=colour, linewidth=0)
    draw_unknown(axes, row.situation, step_s, height)


def draw_unknown(
    axes: Axes, situation: npt.NDArray[np.int64], step_s: float, height: Height
) -> None:
    """A hatched bar where the state [T] is unknown."""
    axes.broken_barh(
        spans(situation == UNKNOWN, step_s),
        height,
        facecolor="white",
        edgecolor=QUIET,
        linewidth=0.5,
        hatch="////",
    )


def spans(flags: BoolArray, step_s: float) -> list[tuple[float, float]]:
    """[T] flags -> start and length in s of every run of them.

    >>> spans(np.array([True, False, True, True]), 0.5)
    [(0.0, 0.5), (1.0, 1.0)]
    """
    firsts, stops = runs_of(flags)
    starts_s = (firsts * step_s).tolist()
    lengths_s = ((stops - firsts) * step_s).tolist()
    return list(zip(starts_s, lengths_s, strict=True))


def trial(
    recording: Recording, kind: str, answered: AnsweredTrial | None = None
) -> str:
    """One trial as it went by: the grip on each sensor, the load along the skin, and its labels.

    answered: the same trial with its answers; a request to act is a shade behind the grip.
    """
    step_s = 1.0 / recording.rate_hz
    t_s = np.arange(len(recording.samples)) * step_s
    forces = np.nan_to_num(recording.samples).reshape(len(t_s), -1, 3)
    with labelled(kind, 5.4, 4.2) as figure:
        grip, load, states = figure.subplots(
            3, 1, sharex=True, height_ratios=(1.1, 1.1, 1)
        )
        grip.plot(t_s, forces[..., NORMAL_AXIS], color=OURS, linewidth=0.9)
        grip.set_ylabel(f"grip, {recording.unit}")
        shear = np.hypot(forces[..., 0], forces[..., 1]).sum(axis=1)
        load.plot(t_s, shear, color=INK, linewidth=1.3)
        load.set_ylabel(f"load, {recording.unit}")
        load.set_ylim(bottom=0.0)
        _draw_truth(states, recording, (-0.4, 0.8))
        states.set_yticks([0, 1], ["truth", "answer"])
        states.set_ylim(1.85 if answered else 0.6, -0.6)
        states.set_xlabel("time in the trial, s")
        if answered is None:
            return svg(figure)

        states.set_xlim(*_shown_s(recording, float(t_s[-1])))
        _draw_answer(states, answered, (0.6, 0.8))
        for first_s, length_s in spans(answered.requests, step_s):
            end_s = first_s + max(length_s, step_s)
            for axes in (grip, load):
                axes.axvspan(first_s, end_s, color=WARNING, alpha=0.3, linewidth=0)
            # A triangle where an act is requested, below the answer.
            states.plot(first_s, 1.6, "^", color=INK, markersize=6)
        return svg(figure)


def _shown_s(recording: Recording, last_s: float) -> tuple[float, float]:
    """What is shown of a trial: about its first slip, or the whole of one without, s."""
    for phase in recording.phases:
        if phase.situation >= SAFE_SLIP:
            at_s = phase.first / recording.rate_hz
            before_s, after_s = AROUND_S
            return max(0.0, at_s + before_s), min(last_s, at_s + after_s)

    return 0.0, min(last_s, MOST_SHOWN_S)


def distributions(times: dict[str, SetTimes], kind: str) -> str:
    """Share of the detected events by delay and lead in ms, one panel a set; "" without events."""
    many = {}
    for name, one in times.items():
        # With fewer, a curve is a few large steps that show no distribution.
        if len(one.of_events.delay_ms) >= LEAST_EVENTS:
            many[name] = one

    if not many:
        return ""

    # One set needs no room for three.
    n_columns = min(COLUMNS, len(many))
    n_rows = math.ceil(len(many) / n_columns)
    width = 3.2 * n_columns + 0.6
    with labelled(kind, width, 2.35 * n_rows + 0.3) as figure:
        panels = figure.subplots(n_rows, n_columns, squeeze=False, sharey=True)
        for axes, (name, one) in zip(panels.flat, many.items(), strict=False):
            of, to_act = one.of_events, one.of_events.delay_ms
            # The first is wide: the second often lies on it.
            first = "to the first risky_slip state"
            _curve(axes, one.to_state_ms, first, "#56b4e9", 3.6)
            _curve(axes, to_act, "to act", "#d55e00")
            _curve(axes, of.available_ms, "lead available", "#009e73", linestyle="--")
            _curve(axes, of.lead_ms, "lead left at act", "#000000")
            axes.set_title(name, fontsize=9, loc="left")
            # Further out where most alarms come late.
            is_late = np.median(to_act) > MOST_MS
            last_ms = float(np.percentile(to_act, 95)) if is_late else MOST_MS
            # Below 0: an alarm within the collar comes before the load onset.
            axes.set(xlim=(-20.0, last_ms), ylim=(0.0, 1.02), xlabel="ms")
            axes.axvline(0.0, color=QUIET, linewidth=0.7)

        # The last row may have fewer sets than columns.
        for axes in panels.flat[len(many) :]:
            axes.set_visible(False)

        first = panels[0, 0]
        first.set_ylabel("share of detected events")
        first.legend(frameon=False, fontsize=7, loc="lower right")
        return svg(figure)


def _curve(
    axes: Axes,
    values: Sequence[float],
    title: str,
    colour: str,
    width: float = 1.2,
    linestyle: str = "-",
) -> None:
    """The cumulative share of some values; nothing without a value."""
    if not values:
        return

    axes.ecdf(
        values,
        label=title,
        color=colour,
        linestyle=linestyle,
        linewidth=width,
    )


def reliability(sets: dict[str, list[CalibrationBin]], kind: str) -> str:
    """Share of risky slips by the probability that was given, one line a set."""
    with labelled(kind, 4.4, 3.0) as figure:
        axes = figure.subplots()
        # On the diagonal a probability is the share that comes true.
        axes.plot([0, 1], [0, 1], color=QUIET, linewidth=0.8)
        for place, (name, bins) in enumerate(sets.items()):
            given = [one.said for one in bins]
            came_true = [one.was for one in bins]
            colour = SET_COLOURS[place % len(SET_COLOURS)]
            axes.plot(
                given,
                came_true,
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
