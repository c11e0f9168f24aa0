"""Actions: what hand and people do in a trial, and the table of all of them.

The hand grips the object that a person holds out, the person lets go, the hand holds for a while,
and then:

    pass        another person takes it slowly, and the hand opens (wait_s: after a pause)
    pull        another person tears at it
    fall        the support vanishes under a grip too weak for the weight
    put-down    a box comes from below and takes the weight; later the hand opens
    hold        disturbances only: of grip (dFn), load (dFt) or motor (dq)
    nothing     the hand stays open and empty

or one of the everyday actions (everyday.py), or of the touches of an empty hand (touches.py). The
module of an action has its parameters, its times and its truth, and is loaded when a scene names
it.

Every action may also have a weak grip with support (weak_share), so that a weak grip does not
announce a fall.
"""

from __future__ import annotations

import importlib
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from holdfast.simulation.effects.effect import Interval, Parameter

NEVER_S = 1e9
"""Time of an event that a trial does not have, s: later than any trial lasts."""
EVERYDAY = (
    "tug",
    "stack",
    "relax",
    "lift",
    "carry",
    "turn",
    "pour",
    "regrip",
    "touch-table",
)
"""What a hand lives through between taking and handing over."""
EMPTY_HANDED = ("nothing", "stroke", "tap")
"""Actions of a hand that holds no object."""
ACTION_MODULES = {
    **dict.fromkeys(("pass", "pull", "fall", "put-down", "hold", "nothing"), "thesis"),
    **dict.fromkeys(EVERYDAY, "everyday"),
    **dict.fromkeys(("stroke", "tap"), "touches"),
}
"""Every action, and the module of this package that has it."""

COMMON = {
    "close_at_s": Parameter(
        {"uniform": [2.6, 3.4]}, "s", 0.05, 100, "when the hand begins to close"
    ),
    "closing_s": Parameter(
        {"uniform": [0.3, 0.5]}, "s", 0.05, 5, "how long closing takes"
    ),
    "grip_n": Parameter(
        {"uniform": [2.5, 6.0]}, "N", 0.1, 70, "normal force of either side"
    ),
    "spare": Parameter(
        {"uniform": [1.4, 2.2]},
        "",
        1,
        20,
        "smallest ratio of the grip to the least grip that holds the weight",
    ),
    "weak_share": Parameter(
        0.25,
        "",
        0,
        1,
        "share of trials with a weak grip, which the person keeps supporting",
    ),
    "weak_grip": Parameter(
        {"uniform": [0.2, 0.75]},
        "",
        0,
        1,
        "ratio of a weak grip to the least grip that holds the weight",
    ),
    "gentlest_n": Parameter(
        0.5,
        "N",
        0,
        70,
        "the weakest grip of the hand; only an object that must fall is held with less",
    ),
    "give_after_s": Parameter(
        {"uniform": [0.15, 0.4]},
        "s",
        0,
        10,
        "from closed hand until the person begins to let go",
    ),
    "give_s": Parameter(
        {"uniform": [0.2, 0.5]}, "s", 0.01, 10, "how long letting go takes"
    ),
    "hold_s": Parameter(
        {"uniform": [2.5, 4.0]}, "s", 0.8, 600, "from closed hand to the action"
    ),
    "tail_s": Parameter(
        {"uniform": [2.0, 3.0]}, "s", 0.2, 600, "the empty hand after the action"
    ),
    "tilt_deg": Parameter(
        {"normal": [0, 6]}, "deg", -60, 60, "of the hand, thumb side down"
    ),
    "roll_deg": Parameter(
        {"normal": [0, 6]}, "deg", -60, 60, "of the hand about the thumb's axis"
    ),
    "finger_n_per_m": Parameter(
        {"uniform": [400, 900]}, "N/m", 50, 1e7, "normal stiffness of a finger"
    ),
    "shear_ratio": Parameter(
        {"uniform": [1.0, 1.6]},
        "",
        0.01,
        100,
        "stiffness along the surface over normal",
    ),
    "share_spread": Parameter(
        0.2, "", 0, 0.9, "spread of the fingers' shares of the grip"
    ),
    "offset_mm": Parameter(
        1.0, "mm", 0, 20, "distance of a contact from the apex of a curved object (sd)"
    ),
    "friction_factor": Parameter(
        {"normal": [1.0, 0.08]}, "", 0, 3, "factor of the object's friction"
    ),
}
"""Parameters of every action, in the order in which they are drawn."""
OPENING = {
    "opening_s": Parameter(
        {"uniform": [0.3, 0.5]}, "s", 0.05, 10, "how long opening takes"
    ),
}
"""Of actions at whose end the hand opens."""


@dataclass(frozen=True)
class Course:
    """When things happen in an action.

    moves      intervals in which the action moves anything, s
    opens_s    the hand begins to open
    taken_s    from the begin of the action until it takes the weight from a person who supports it
    carried_s  how long the action lasts, if that is longer than until the hand is open
    """

    moves: list[Interval]
    opens_s: float = NEVER_S
    taken_s: float = NEVER_S
    carried_s: float = 0.0


@dataclass(frozen=True)
class Action:
    """One action of the table.

    parameters  of its own, drawn after the common ones
    course      (draws, begin in s) -> when things happen
    mark        marks the situations of a trial in its truth.Steps
    load_n      (trial, weight in N) -> largest force along the skin that it asks for, N
    loaded      its slip begins with a load from outside, else with the slip itself
    touched     of an empty hand: (trial, motion, averaging time in s) -> motion with the touches
    touch_truth of an empty hand: (motion, end in s) -> Truth
    """

    parameters: dict[str, Parameter]
    course: Callable[[Mapping[str, float], float], Course] = lambda drawn, act: Course(
        []
    )
    mark: Callable[[Any], None] = lambda steps: None
    load_n: Callable[[Any, float], float] = lambda trial, weight_n: weight_n
    loaded: bool = True
    touched: Callable[..., Any] | None = None
    touch_truth: Callable[..., Any] | None = None


def action_named(name: str) -> Action:
    """An action of ACTION_MODULES; loads its module."""
    path = f"{__name__}.{ACTION_MODULES[name]}"
    actions: dict[str, Action] = importlib.import_module(path).ACTIONS
    return actions[name]


def parameters_of(action: str) -> dict[str, Parameter]:
    """All parameters of an action in the order in which they are drawn."""
    return COMMON | action_named(action).parameters
