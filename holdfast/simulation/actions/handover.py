"""Hand-overs: a person takes the object, or a box takes its weight, and the hand opens."""

from __future__ import annotations

from collections.abc import Mapping

from holdfast.core.contract import GRASP, SAFE_SLIP
from holdfast.simulation.actions import OPENING, Action, Course
from holdfast.simulation.effect import Parameter
from holdfast.simulation.protocol import PlannedTrial
from holdfast.simulation.script_times import BOX_GAP_M, BOX_OVERSHOOT_M, Times
from holdfast.simulation.stepper import TrialMotion
from holdfast.simulation.truth import Mark, Steps, change_n, first_of

TRANSFERRED = 0.95
"""Share of the final force at which the weight counts as taken over."""


def pass_course(drawn: Mapping[str, float], act: float) -> Course:
    """The taker takes the weight, and moves after a pause."""
    # The wearer opens the hand after the taker has begun to move, not when the taker arrives.
    starts = act + drawn["wait_s"]
    opens = starts + drawn["open_after_s"]
    takes = (act, act + drawn["take_s"])
    moves = (starts, opens + drawn["opening_s"])

    # The hand may be open before the taker has carried the object all the way, or after it.
    carried_s = drawn["wait_s"] + drawn["move_s"]
    return Course([takes, moves], opens, drawn["take_s"], carried_s)


def put_down_course(drawn: Mapping[str, float], act: float) -> Course:
    """The box comes, and the hand opens later."""
    touches_s = BOX_GAP_M / drawn["box_m_s"]
    rises_s = (BOX_GAP_M + BOX_OVERSHOOT_M) / drawn["box_m_s"]
    opens = act + touches_s + drawn["open_after_s"]
    return Course([(act, act + rises_s)], opens, touches_s)


def mark_hand_over(
    marks: list[Mark],
    trial: PlannedTrial,
    motion: TrialMotion,
    times: Times,
    steps: Steps,
) -> None:
    """Safe while the weight goes over, and again when the hand opens."""
    at_s = motion.at_s
    onset = steps.onset
    if onset is None or onset >= steps.lost:
        return

    more: list[Mark] = [(at_s[onset], SAFE_SLIP)]
    before_opening = at_s < times.open
    pauses = trial.action != "pass" or trial.drawn["wait_s"] != 0.0
    if pauses and before_opening[onset:].any():
        # The force that people and box carry in the pause before the hand opens.
        size_n = change_n(motion, onset)
        plateau_n = size_n[before_opening][-1]
        taken = first_of(size_n >= TRANSFERRED * plateau_n, onset)
        taken_s = at_s[onset if taken is None else taken]
        if taken_s < times.open:
            more += [(taken_s, GRASP), (times.open, SAFE_SLIP)]

    # The taker may have the object before the hand opens.
    gone_s = steps.gone_s(motion)
    marks += [mark for mark in more if mark[0] < gone_s]


PASS = {
    **OPENING,
    "distance_m": Parameter(
        {"uniform": [0.08, 0.25]}, "m", 0, 3, "how far the taker carries it"
    ),
    "move_s": Parameter({"uniform": [1.0, 2.2]}, "s", 0.05, 60, "duration of the move"),
    "open_after_s": Parameter(
        {"uniform": [0.25, 0.8]}, "s", 0, 60, "from taking to opening"
    ),
    "take_s": Parameter(
        {"uniform": [0.2, 0.6]},
        "s",
        0.01,
        60,
        "time in which the taker takes over the weight",
    ),
    "wait_s": Parameter(
        0.0, "s", 0, 60, "pause of the taker between taking the weight and moving"
    ),
    "arm_n_per_m": Parameter(
        {"log_uniform": [150, 600]}, "N/m", 1, 1e5, "stiffness of the taker's arm"
    ),
    "cap_n": Parameter(
        {"uniform": [4, 12]}, "N", 0.1, 500, "largest pull of the taker"
    ),
}
"""Parameters of the action `pass`."""
PUT_DOWN = {
    **OPENING,
    "box_m_s": Parameter(
        {"uniform": [0.02, 0.06]},
        "m/s",
        0.001,
        2,
        "how fast the hand comes down on the box",
    ),
    "press": Parameter(
        {"uniform": [1.0, 1.3]}, "", 1, 50, "force on the box over the weight"
    ),
    "excess_n": Parameter(
        {"uniform": [0.0, 0.5]},
        "N",
        0,
        100,
        "constant part of the force on the box",
    ),
    "open_after_s": Parameter(
        {"uniform": [1.5, 3.0]}, "s", 0, 60, "from touching the box to opening"
    ),
}
"""Parameters of the action `put-down`."""
ACTIONS = {
    "pass": Action(PASS, pass_course, mark_hand_over),
    "put-down": Action(PUT_DOWN, put_down_course, mark_hand_over),
}
