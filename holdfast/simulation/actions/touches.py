"""Touches of the pads of an open, empty hand: a person strokes them or taps on them.

A stroke presses with a force that comes and goes smoothly and rubs along the pad: shear = friction
times normal, in one direction. A tap is half a sine of normal force, which leans a little. Nothing
is held, so no situation is a slip: it is a grasp while a pad bears more than the contact floor of
the training (trial_layout.NORMAL_FLOOR), and nothing else. All ranges are assumed.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from holdfast.core.contract import GRASP, NORMAL_FLOOR, NOTHING, FloatArray
from holdfast.simulation.actions import Action
from holdfast.simulation.effects.effect import Parameter
from holdfast.simulation.scenes.protocol import PlannedTrial
from holdfast.simulation.scenes.stepper import TrialMotion
from holdfast.simulation.scenes.truth import Mark, Truth

TOUCHES = {
    "lasts_s": Parameter({"uniform": [8, 15]}, "s", 0.5, 3600, "of the whole trial"),
    "first_s": Parameter({"uniform": [2, 3.5]}, "s", 0, 600, "until the first touch"),
    "press_n": Parameter(
        {"log_uniform": [0.2, 6]}, "N", 0, 200, "largest normal force on a pad"
    ),
    "every_s": Parameter(
        {"uniform": [0.4, 2]}, "s", 0.02, 60, "from one touch to the next"
    ),
    "pads": Parameter({"choice": [1, 1, 2, 3]}, "", 1, 200, "pads touched at once"),
    "first_pad": Parameter(
        {"uniform": [0, 1]}, "", 0, 1, "place of the first of them among all pads"
    ),
    "direction_deg": Parameter(
        {"uniform": [0, 360]}, "deg", 0, 360, "of the shear on a pad"
    ),
}
"""Parameters of both actions."""
EDGE = 0.2
"""Share of a stroke in which the force comes, and in which it goes."""
WITHIN = 8
"""Points of time within the chip's averaging of a sample."""


def pressed_n(trial: PlannedTrial, t_s: FloatArray) -> FloatArray:
    """[T] normal force on each touched pad."""
    drawn = trial.drawn
    since_s = t_s - drawn["first_s"]

    # A touch is over before the next one begins.
    every_s = max(drawn["every_s"], drawn["touch_s"])
    number = np.floor(since_s / every_s)

    # How far this touch has come; after it, 1, at which every shape is zero.
    u = np.clip((since_s - number * every_s) / drawn["touch_s"], 0.0, 1.0)
    if trial.action == "tap":
        shape = np.sin(np.pi * u)
    else:
        edge = np.minimum(np.minimum(u, 1.0 - u) / EDGE, 1.0)
        shape = np.sin(0.5 * np.pi * edge) ** 2

    # Before the first touch there is none.
    return drawn["press_n"] * np.where(number >= 0, shape, 0.0)


def forces_n(trial: PlannedTrial, t_s: FloatArray) -> FloatArray:
    """[T, S, 3] on the pads: shear x, y, normal."""
    drawn = trial.drawn

    # Shear and normal rise together: the finger that rubs is always at the limit of its friction.
    angle = np.radians(drawn["direction_deg"])
    rub = drawn["rub"]
    along = np.array([rub * np.cos(angle), rub * np.sin(angle), 1.0])

    # Neighbouring pads are touched at once; those beyond the last one do not exist.
    n_pads = trial.hand.n_contacts
    first = int(drawn["first_pad"] * (n_pads - 1) + 0.5)
    forces = np.zeros((len(t_s), n_pads, 3))
    touched = slice(first, first + round(drawn["pads"]))
    forces[:, touched] = (pressed_n(trial, t_s)[:, None] * along)[:, None]
    return forces


def touched(trial: PlannedTrial, motion: TrialMotion, average_s: float) -> TrialMotion:
    """The motion of an empty hand, with the touches; average_s: of the chip, before a sample."""
    if average_s == 0.0:
        return replace(motion, forces_n=forces_n(trial, motion.t_s))

    # As the chip does: the mean over the time before each sample.
    mean_n = np.zeros_like(motion.forces_n)
    for k in range(WITHIN):
        before_s = average_s * (k + 0.5) / WITHIN
        mean_n += forces_n(trial, motion.t_s - before_s) / WITHIN
    return replace(motion, forces_n=mean_n)


def touch_truth(motion: TrialMotion, end_s: float) -> Truth:
    """A grasp while a pad bears more than the contact floor; never a slip."""
    touches = motion.forces_n[:, :, 2].max(axis=1) > NORMAL_FLOOR["N"]

    # A situation begins at the sample at which the touch begins or ends.
    marks: list[Mark] = [(0.0, NOTHING)]
    for row in np.flatnonzero(np.diff(touches, prepend=False)):
        marks.append((float(motion.t_s[row]), GRASP if touches[row] else NOTHING))

    # The first touch and the end of the last one stand for contact and its loss.
    contact_s = None
    lost_s = None
    rows = np.flatnonzero(touches)
    if rows.size:
        contact_s = float(motion.t_s[rows[0]])
        # A sample lasts until the next one would come.
        lost_s = float(motion.t_s[rows[-1]]) + end_s - float(motion.t_s[-1])
    return Truth(contact_s, None, None, None, lost_s, 0.0, tuple(marks), end_s)


ACTIONS = {
    "stroke": Action(
        {
            **TOUCHES,
            "touch_s": Parameter(
                {"uniform": [0.2, 1.2]}, "s", 0.01, 60, "duration of a stroke"
            ),
            "rub": Parameter(
                {"uniform": [0.2, 0.9]}, "", 0, 3, "shear over normal force"
            ),
        },
        touched=touched,
        touch_truth=touch_truth,
    ),
    "tap": Action(
        {
            **TOUCHES,
            "touch_s": Parameter(
                {"log_uniform": [0.02, 0.15]}, "s", 0.005, 60, "duration of a tap"
            ),
            "rub": Parameter(
                {"uniform": [0, 0.3]}, "", 0, 3, "shear over normal force"
            ),
        },
        touched=touched,
        touch_truth=touch_truth,
    ),
}
