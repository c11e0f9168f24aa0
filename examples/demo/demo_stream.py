"""The demo's picture of a trial over time: forces, critical points, truth, a model's answers."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
import numpy.typing as npt
from matplotlib.axes import Axes

from holdfast.core.contract import (
    NORMAL_AXIS,
    RISKY_SLIP,
    SAFE_SLIP,
    SITUATIONS,
    BoolArray,
    FloatArray,
)
from holdfast.core.hand_card import read_hand_card, sensor_names
from holdfast.core.trial_layout import HAND_FILE, read_json, truth_path
from holdfast.data.critical_points import CriticalPoint, offline_critical_points
from holdfast.data.recording import Recording
from holdfast.data.timeline import Phase, read_truth
from holdfast.evaluation.formats import spaced
from holdfast.evaluation.pictures import draw_unknown, spans
from holdfast.evaluation.style import INK, NOTE, QUIET, SITUATION_COLOURS, labelled, svg

FINGER_COLOURS = ("#000000", "#999933", "#0072b2", "#e69f00", "#cc79a7", "#882255")
FINGER_LINES = ("-", "--", "-", "--", "-", "--")
"""Of thumb 1 and 2, index, middle, ring and little finger: none is a situation's colour, and a line
behind a dashed one still shows."""
EVENTS = {
    "load_onset_s": "load",
    "incipient_slip_s": "",
    "gross_slip_s": "gross slip",
    "contact_lost_s": "lost",
}
"""Event of a truth -> its name in a picture; "": not drawn."""
AROUND_S = (-0.35, 0.65)
"""The second column shows so long before and after the action's first sign."""


@dataclass(frozen=True)
class StreamPicture:
    """One unseen trial. answer [T]: a situation or UNKNOWN. acts [T]: where an act is requested.

    events: times in s of the truth's events that happened, by name. names: of the sensors.
    """

    recording: Recording
    names: tuple[str, ...]
    phases: tuple[Phase, ...]
    events: dict[str, float]
    points: list[CriticalPoint]
    answer: npt.NDArray[np.int64]
    acts: BoolArray


def picture_of(
    folder: Path,
    recording: Recording,
    answer: npt.NDArray[np.int64],
    acts: BoolArray,
) -> StreamPicture:
    """The answers on a trial of a folder, with its truth. answer, acts: [T]."""
    truth = truth_path(folder / f"{recording.trial_id}.csv")
    times = read_json(truth)

    events = {}
    for name in EVENTS:
        # A truth names every event, with null for those that did not happen.
        if times.get(name) is not None:
            events[name] = float(times[name])

    # By the rate and not by the recorded stamps, as the model counts time.
    t_s = np.arange(len(recording.samples)) / recording.rate_hz

    card = folder / HAND_FILE
    hand = read_hand_card(card) if card.is_file() else None

    return StreamPicture(
        recording=recording,
        names=sensor_names(hand, recording.n_sensors),
        phases=read_truth(truth).phases_on(t_s, truth),
        events=events,
        points=offline_critical_points(recording),
        answer=answer,
        acts=acts,
    )


def stream(picture: StreamPicture, kind: str) -> str:
    """Forces with critical points, and the decision over the truth; right, the action alone."""
    # Two columns: the whole trial, and the second around the action, at the same heights.
    recording = picture.recording
    t_s = np.arange(len(recording.samples)) / recording.rate_hz
    forces = recording.samples.reshape(len(t_s), -1, 3)
    normal_n = forces[..., NORMAL_AXIS]
    # The length of both shear axes: the direction of a slip does not matter here.
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
            _forces(grid[0, column], t_s, normal_n, picture)
            _forces(grid[1, column], t_s, shear_n, picture)
            _decision(grid[2, column], picture)
            grid[2, column].set_xlabel("time in the trial, s")

        whole = grid[0, 0]
        action = grid[0, 1]
        whole.set_ylabel("normal, N")
        grid[1, 0].set_ylabel("shear, N")
        action.set_xlim(*_around(picture, t_s))
        whole.set_xlim(0.0, t_s[-1])
        # After the limits are set: only events within them get a name.
        _name_events(action, picture)

        whole.legend(
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
    """One line a sensor; dotted, the labeller's critical points; dashed, the truth's events."""
    for k, name in enumerate(picture.names):
        # Of more sensors than colours, the second round is dotted.
        is_first = k < len(FINGER_COLOURS)
        axes.plot(
            t_s,
            force_n[:, k],
            FINGER_LINES[k] if is_first else ":",
            color=FINGER_COLOURS[k % len(FINGER_COLOURS)],
            linewidth=0.9,
            label=name,
        )

    # Both stand in the same panel, so that the labeller can be compared with the truth.
    for point in picture.points:
        axes.axvline(point.t_s, color=INK, linewidth=0.9, linestyle=":")

    for _, at_s in _named_events(picture):
        axes.axvline(at_s, color=QUIET, linewidth=0.8, linestyle="--")


def _decision(axes: Axes, picture: StreamPicture) -> None:
    """Behind, the truth in pale colour; in front, the state in full colour at its own height."""
    step_s = 1.0 / picture.recording.rate_hz
    for phase in picture.phases:
        start_s = phase.first * step_s
        stop_s = phase.stop * step_s
        axes.axvspan(
            start_s,
            stop_s,
            color=SITUATION_COLOURS[phase.situation],
            alpha=0.35,
            linewidth=0,
        )

    for situation, colour in enumerate(SITUATION_COLOURS):
        here = spans(picture.answer == situation, step_s)
        axes.broken_barh(
            here,
            (situation - 0.32, 0.64),
            color=colour,
            edgecolor=INK,
            linewidth=0.4,
        )

    # Unknown has no height of its own and stands where "nothing" is drawn.
    draw_unknown(axes, picture.answer, step_s, (-0.32, 0.64))

    # The triangle stands at the first sample of a request, where the hand begins to act.
    for first_s, _ in spans(picture.acts, step_s):
        axes.plot(first_s, RISKY_SLIP + 0.62, "v", color=INK, markersize=6)

    names = list(map(spaced, SITUATIONS))
    axes.set_yticks(range(len(names)), names)
    # Room above risky slip for the triangle of a request.
    axes.set_ylim(-0.5, len(names))


def _around(picture: StreamPicture, t_s: FloatArray) -> tuple[float, float]:
    """The time around the action: its load onset, else the start of the first slip of the truth."""
    at_s = picture.events.get("load_onset_s")
    if at_s is None:
        at_s = _first_slip_s(picture, t_s)
    before_s, after_s = AROUND_S
    return at_s + before_s, at_s + after_s


def _first_slip_s(picture: StreamPicture, t_s: FloatArray) -> float:
    """Start of the truth's first slip, or the middle of a trial without one."""
    for phase in picture.phases:
        if phase.situation >= SAFE_SLIP:
            return float(t_s[phase.first])
    return float(t_s[-1]) / 2.0


def _named_events(picture: StreamPicture) -> list[tuple[str, float]]:
    """Name and time in s of the events that a picture shows."""
    named = []
    for key, at_s in picture.events.items():
        if EVENTS[key]:
            named.append((EVENTS[key], at_s))
    return named


def _name_events(axes: Axes, picture: StreamPicture) -> None:
    """Names above the dashed lines, each higher than the one before, since they are close."""
    low, high = axes.get_xlim()
    for place, (name, at_s) in enumerate(_named_events(picture)):
        if not low < at_s < high:
            continue
        # One line of small print higher for each event before it.
        above_points = 1 + 8 * place
        axes.annotate(
            name,
            (at_s, 1.0),
            (2, above_points),
            xycoords=("data", "axes fraction"),
            textcoords="offset points",
            fontsize=7,
            color=NOTE,
        )
