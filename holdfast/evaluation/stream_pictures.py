"""A stream over time: forces, critical points, truth and decision; and a figure with its kind.

Which trials a report draws: the first of each kind, chosen before any answer is known.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from typing import NamedTuple

import matplotlib as mpl
import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from holdfast.core.contract import (
    NORMAL_AXIS,
    RISKY_SLIP,
    SITUATIONS,
    BoolArray,
    FloatArray,
)
from holdfast.edge_runtime.decision import UNKNOWN
from holdfast.evaluation.methods import LabelledTrial
from holdfast.evaluation.model_outputs import ModelOutputs, StreamPicture
from holdfast.evaluation.style import (
    FINGER_COLOURS,
    FINGER_LINES,
    INK,
    QUIET,
    SITUATION_COLOURS,
    STYLE,
    WARNING,
    svg,
)

FINGERS = ("thumb 1", "thumb 2", "index", "middle", "ring", "little")
AROUND_S = (-0.35, 0.65)
"""The second column shows so long before and after the action's first sign."""
EVENT_NAMES = {
    "load_onset_s": "load",
    "gross_slip_s": "gross slip",
    "contact_lost_s": "lost",
}


@contextmanager
def labelled(kind: str, width: float, height: float) -> Iterator[Figure]:
    """A figure in the common style that shows the kind of its data (simulated, recorded)."""
    with mpl.rc_context(STYLE):
        figure = Figure(figsize=(width, height))
        figure.suptitle(
            kind, x=0.995, ha="right", fontsize=8, color=WARNING, style="italic"
        )
        yield figure


def stream(picture: StreamPicture, kind: str) -> str:
    """Forces with critical points, and the decision over the truth; right, the action alone."""
    recording = picture.recording
    t_s = np.arange(len(recording.samples)) / recording.rate_hz
    forces = recording.samples.reshape(len(t_s), -1, 3)
    shear_n = np.hypot(forces[..., 0], forces[..., 1])
    with labelled(kind, 10.4, 5.6) as figure:
        grid = figure.subplots(
            3,
            2,
            sharex="col",
            sharey="row",
            width_ratios=(2.1, 1),
            height_ratios=(1.2, 1.2, 1),
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
            frameon=False,
            fontsize=7,
            ncols=6,
            loc="lower left",
            bbox_to_anchor=(0.0, 1.0),
        )
        return svg(figure)


def _forces(
    axes: Axes, t_s: FloatArray, force_n: FloatArray, picture: StreamPicture
) -> None:
    """One line a finger; dotted, the labeller's critical points; dashed, the truth's events."""
    for finger in range(min(force_n.shape[1], len(FINGERS))):
        colour, line = FINGER_COLOURS[finger], FINGER_LINES[finger]
        axes.plot(
            t_s,
            force_n[:, finger],
            line,
            color=colour,
            linewidth=0.9,
            label=FINGERS[finger],
        )
    for point in picture.points:
        axes.axvline(point.t_s, color=INK, linewidth=0.9, linestyle=":")
    for name in EVENT_NAMES:
        if name in picture.events:
            axes.axvline(
                picture.events[name], color=QUIET, linewidth=0.8, linestyle="--"
            )


def _decision(axes: Axes, t_s: FloatArray, picture: StreamPicture) -> None:
    """Behind, the truth in pale colour; in front, the state in full colour at its own height."""
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
        (first * step_s, (stop - first) * step_s)
        for first, stop in runs(picture.answer == UNKNOWN)
    ]
    axes.broken_barh(
        unknown,
        (-0.32, 0.64),
        facecolor="white",
        edgecolor=QUIET,
        linewidth=0.6,
        hatch="////",
    )
    for first, _ in runs(picture.acts):
        axes.plot(first * step_s, RISKY_SLIP + 0.62, "v", color=INK, markersize=6)
    axes.set_yticks(
        range(len(SITUATIONS)), [name.replace("_", " ") for name in SITUATIONS]
    )
    axes.set_ylim(-0.5, len(SITUATIONS))


def runs(there: np.ndarray) -> list[tuple[int, int]]:
    """[T] flags -> runs [first, stop).

    >>> runs(np.array([True, False, True, True]))
    [(0, 1), (2, 4)]
    """
    change = np.diff(there.astype(np.int8), prepend=0, append=0)
    starts, stops = (
        np.flatnonzero(change == 1).tolist(),
        np.flatnonzero(change == -1).tolist(),
    )
    return list(zip(starts, stops, strict=True))


def _around(picture: StreamPicture, t_s: FloatArray) -> tuple[float, float]:
    """The time around the action: its load onset, else the start of the first slip of the truth."""
    slips = [phase.first for phase in picture.phases if phase.situation >= 2]
    at_s = picture.events.get(
        "load_onset_s", float(t_s[slips[0]]) if slips else float(t_s[-1]) / 2.0
    )
    return at_s + AROUND_S[0], at_s + AROUND_S[1]


def _name_events(axes: Axes, picture: StreamPicture) -> None:
    """Names above the dashed lines, each higher than the one before, since they are close."""
    low, high = axes.get_xlim()
    shown = [
        (picture.events[key], name)
        for key, name in EVENT_NAMES.items()
        if key in picture.events
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


ROWS_SHOWN = 8


class _Kind(NamedTuple):
    """An action, and an object that must (or must not) be in the hand; "": any object."""

    action: str
    object_name: str
    wanted: bool


KINDS = (
    _Kind("pass", "full-bottle", False),
    _Kind("pull", "", False),
    _Kind("fall", "", False),
    _Kind("put-down", "", False),
    _Kind("pass", "full-bottle", True),
)
"""One picture each."""


@dataclass(frozen=True)
class ShownTrial:
    """A trial to be drawn: its truth, the state and the request to act at every sample [T]."""

    trial: LabelledTrial
    situation: npt.NDArray[np.int64]
    requests: BoolArray


def shown_trials(
    trials: Sequence[LabelledTrial],
    outputs: Sequence[ModelOutputs],
    requests: Sequence[BoolArray],
) -> dict[str, list[ShownTrial]]:
    """Title -> the first trials of each kind, objects interleaved; no title without a trial."""
    shown = {}
    for kind in KINDS:
        fits = [k for k, one in enumerate(trials) if _fits(one, kind)]
        title = f"{kind.action}, {kind.object_name}" if kind.wanted else kind.action
        rows = _interleaved(trials, fits)[:ROWS_SHOWN]
        if rows:
            shown[title] = [
                ShownTrial(trials[k], outputs[k].situation, requests[k]) for k in rows
            ]
    return shown


def _fits(trial: LabelledTrial, kind: _Kind) -> bool:
    recording = trial.recording
    if recording.action != kind.action:
        return False
    return (
        not kind.object_name
        or (recording.object_name == kind.object_name) == kind.wanted
    )


def _interleaved(trials: Sequence[LabelledTrial], places: Sequence[int]) -> list[int]:
    """The places, the first trial of every object before the second of any."""
    count: dict[str | None, int] = {}
    dealt = []
    for k in places:
        name = trials[k].recording.object_name
        count[name] = count.get(name, 0) + 1
        dealt.append((count[name], k))
    return [k for _, k in sorted(dealt)]
