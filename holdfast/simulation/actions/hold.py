"""A hold with disturbances of grip, load or motor, and the hand that stays empty."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from holdfast.core.contract import GRASP, RISKY_SLIP, SAFE_SLIP
from holdfast.simulation.actions import OPENING, Action, Course
from holdfast.simulation.effect import Parameter
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.script_times import CATCH_S, Times
from holdfast.simulation.stepper import TrialMotion
from holdfast.simulation.truth import Mark, Steps, first_of, slipped_far, step_at


def hold_course(drawn: Mapping[str, float], act: float) -> Course:
    """Pulses; the person has come back, and has held the object for as long, before the opening."""
    disturbed_s = drawn["times"] * drawn["every_s"]
    opens = act + disturbed_s + 2.0 * CATCH_S

    moves = [(opens - CATCH_S, opens)]
    for k in range(round(drawn["times"])):
        start = act + k * drawn["every_s"]
        moves.append((start, start + drawn["pulse_s"]))
    return Course(moves, opens)


def mark_disturbances(
    marks: list[Mark],
    trial: PlannedTrial,
    motion: TrialMotion,
    times: Times,
    steps: Steps,
) -> None:
    """A grasp, unless the object slips 2 mm or is lost before the hand opens."""
    at_s = motion.at_s
    lost = steps.lost
    acts = step_at(motion, times.act)
    opens = step_at(motion, times.open)
    stop = min(opens, lost)
    far = slipped_far(motion, min(acts, len(at_s) - 1))

    if first_of(far, acts, stop) is not None:
        sliding = acts + np.flatnonzero(motion.slips[acts:stop])
        if not sliding.size:
            # It has turned with the skin, which slides nowhere.
            sliding = acts + np.flatnonzero(far[acts:stop])
        marks.append((at_s[sliding[0]], RISKY_SLIP))
        if lost > opens:
            # A slip that ends before the hand opens ends as a grasp.
            marks.append((at_s[sliding[-1]], GRASP))
    if lost > opens:
        marks.append((times.open, SAFE_SLIP))


HOLD = {
    **OPENING,
    "grip_change": Parameter(
        0.0, "", -1, 5, "dFn: change of grip at a disturbance, over the grip"
    ),
    "load_n": Parameter(
        0.0, "N", -50, 50, "dFt: force along the object at a disturbance"
    ),
    "motor_mm": Parameter(
        0.0,
        "mm",
        -20,
        20,
        "dq: travel of the fingers (not the thumb) at a disturbance",
    ),
    "times": Parameter(3.0, "", 0, 100, "number of disturbances"),
    "every_s": Parameter({"uniform": [0.8, 1.4]}, "s", 0.2, 60, "from one to the next"),
    "pulse_s": Parameter({"uniform": [0.1, 0.4]}, "s", 0.01, 10, "how long one lasts"),
}
"""Parameters of the action `hold`."""
NOTHING = {
    "lasts_s": Parameter(20.0, "s", 0.5, 3600, "how long the hand stays empty"),
}
"""Parameter of the action `nothing`."""
ACTIONS = {
    "hold": Action(HOLD, hold_course, mark_disturbances),
    "nothing": Action(NOTHING),
}
