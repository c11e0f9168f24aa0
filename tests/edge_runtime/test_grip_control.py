"""One hand's grip controller: from a prediction and forces to one command and one line."""

from __future__ import annotations

import json
from typing import Any

import numpy as np
import pytest
from hazard_marks import LOST_SENSOR
from made_prediction import prediction

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import UsageError
from holdfast.edge_runtime.grip import Holdfast
from holdfast.edge_runtime.grip_control import GripControl, sense_of
from holdfast.edge_runtime.supervisor import (
    EXPIRES_MS,
    MODES,
    GripCommand,
    Limits,
    last_line,
    to_line,
)

RATE_HZ = 150.0
ALL = np.ones(6, dtype=np.bool_)
HELD = np.tile([0.1, 0.0, 1.0], 6)
"""Six fingers press with 1 N each: 3 N a side, 0.6 N along the skin."""
AWKWARD = (np.nan, np.inf, -np.inf, 1e308, -1e308, 1e200, 5e-324, -1.0)


RISKY: dict[str, Any] = {"state": "risky_slip", "p_risky": 1.0}
UNKNOWN: dict[str, Any] = {"state": "unknown", "why": "sensors", "p_risky": 0.9}


def step(
    control: GripControl,
    forces: FloatArray = HELD,
    valid: BoolArray = ALL,
    **changes: Any,
) -> GripCommand:
    return control.step(prediction(**changes), forces, valid)


def held(name: str = "holdfast", **options: Any) -> GripControl:
    """After a quiet hold that is no longer young."""
    control = GripControl(name, RATE_HZ, **options)
    for _ in range(330):
        step(control)
    return control


def test_a_quiet_hold_is_idle_and_has_no_target() -> None:
    command = step(held())
    assert (command.mode, command.target_n, command.feedback) == ("idle", None, 0.0)
    assert command.reason == "grasp"
    assert (command.mu_hat, command.margin, command.needed_n) == (None, None, None)


def test_a_risky_slip_tightens_and_is_felt() -> None:
    command = step(held(), **RISKY)
    assert (command.mode, command.reason, command.feedback) == (
        "tighten",
        "risky slip",
        1.0,
    )
    assert command.target_n == pytest.approx(3.0 + Holdfast.SETTING)
    assert command.slew_n_s == Limits().slew_n_s
    assert (command.sequence, command.t_ns) == (7, 10**9)


@LOST_SENSOR.mark
def test_a_target_is_held_while_the_state_is_unknown() -> None:
    control = held()
    given = step(control, **RISKY)
    for _ in range(500):
        command = step(control, **UNKNOWN)
        assert (command.mode, command.target_n) == ("hold", given.target_n)
        assert (command.reason, command.feedback) == ("unknown: sensors", 0.0)


def test_an_unknown_state_with_nothing_given_is_a_hold_without_a_target() -> None:
    for control in (GripControl("holdfast", RATE_HZ), held()):
        command = step(control, **UNKNOWN)
        assert (command.mode, command.target_n) == ("hold", None)


@pytest.mark.parametrize(
    ("command", "reason"), [("opening", "opening"), ("overridden", "override")]
)
def test_the_wearer_ends_the_target_and_the_command_says_so(
    command: str, reason: str
) -> None:
    control, ends = held(), RISKY | {command: True}
    step(control, **RISKY)
    ended = step(control, **ends)
    assert (ended.mode, ended.target_n, ended.reason) == ("yield", None, reason)
    assert step(control, **ends).mode == "idle"


def test_a_friction_estimate_is_published_with_what_it_asks_for() -> None:
    control, sliding = held(), np.tile([0.5, 0.0, 1.0], 6)
    for _ in range(6):
        command = step(control, sliding, **RISKY)
    assert command.mu_hat == pytest.approx(0.5)
    assert command.margin == pytest.approx(0.0, abs=1e-6)
    assert command.needed_n == pytest.approx(1.25 * 3.0)


# units and shapes


def test_raw_fields_have_ratios_and_no_newtons_and_every_reason_says_so() -> None:
    control, sliding = held(unit="uT"), 1000.0 * np.tile([0.5, 0.0, 1.0], 6)
    # long enough for a load that came at once to be one that stays
    commands = [step(control, sliding, **RISKY) for _ in range(600)]
    assert commands[0].mode == "tighten"
    assert commands[-1].mode == "hold"
    assert {(one.target_n, one.needed_n) for one in commands} == {(None, None)}
    assert commands[-1].mu_hat == pytest.approx(0.5)
    assert commands[0].reason == "risky slip (reduced: no N)"
    assert commands[-1].reason == "risky_slip (reduced: no N)"
    assert all(one.reason.endswith(" (reduced: no N)") for one in commands)


def test_a_rise_in_newtons_does_not_end_an_answer_on_raw_fields() -> None:
    """The fields grow by far more than six while it lasts."""
    control = held(unit="uT")
    modes = [step(control, k * HELD, **RISKY).mode for k in (1.0, 20.0, 40.0, 60.0)]
    assert modes == ["tighten"] * 4


def test_a_ceiling_in_newtons_does_not_end_the_grip_on_raw_fields() -> None:
    control = held(unit="uT")
    for _ in range(75):
        step(control, 1000.0 * HELD)
    assert step(control, 1000.0 * HELD, **RISKY).mode == "tighten"
    assert step(control, 1000.0 * HELD).mode == "relax"


def test_an_unknown_controller_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(UsageError, match="choose from none, holdfast"):
        GripControl("smsp", RATE_HZ)


@pytest.mark.parametrize("fingers", [0, 5, 16])
def test_another_number_of_fingers_is_refused(fingers: int) -> None:
    with pytest.raises(UsageError, match=f"{fingers} sensors, .* made for 6"):
        step(held(), np.zeros(3 * fingers), np.ones(fingers, dtype=np.bool_))
    with pytest.raises(UsageError):
        step(held(), HELD, np.ones(5, dtype=np.bool_))


# bad readings


@LOST_SENSOR.mark
def test_an_invalid_sensor_counts_as_no_force_whatever_it_reads() -> None:
    valid = ALL.copy()
    valid[2] = False
    commands = []
    for value in (*AWKWARD, 2.0, 0.0):
        forces = HELD.copy()
        forces[6:9] = value
        control = held()
        commands.append(step(control, forces, valid, **RISKY))
    assert len(set(commands)) == 1
    assert commands[0].target_n == pytest.approx(2.975 + Holdfast.SETTING, abs=0.06)


@pytest.mark.parametrize("axis", range(3))
@pytest.mark.parametrize("value", AWKWARD)
def test_no_reading_makes_a_nan_at_its_sample_or_later(value: float, axis: int) -> None:
    forces = HELD.copy()
    forces[axis::3] = value
    control = held()
    commands = [step(control, forces, **one) for one in (RISKY, RISKY, {}, UNKNOWN)]
    commands += [step(control, HELD, **RISKY) for _ in range(6)]
    for command in commands:
        assert "NaN" not in (line := to_line(command))
        assert "Infinity" not in line


# the line


def test_a_line_is_json_that_gives_the_command_back_with_its_expiry() -> None:
    control = held()
    for command in (step(control), step(control, **RISKY), step(control, **UNKNOWN)):
        line = to_line(command)
        values = json.loads(line)
        assert "\n" not in line
        assert values.pop("expires_ms") == EXPIRES_MS
        again = GripCommand(**values)
        assert again.mode in MODES
        assert again.target_n == pytest.approx(command.target_n, abs=1e-4)
        assert again.reason == command.reason


def test_the_last_line_of_a_run_is_a_hold() -> None:
    values = json.loads(last_line(9, 5, "stopped"))
    assert (values["mode"], values["target_n"], values["slew_n_s"]) == (
        "hold",
        None,
        0.0,
    )
    assert (values["sequence"], values["t_ns"], values["reason"]) == (9, 5, "stopped")
    assert values["expires_ms"] == EXPIRES_MS


# -- what is sensed, at its limits


@pytest.mark.parametrize(
    ("thumb", "flags", "weights"),
    [
        (None, (1, 0, 1, 1), (1, 1, 1)),
        ((1, 0, 0, 0), (1, 1, 1, 1), (1, 1, 1, 1)),
        ((1, 0, 0, 0), (1, 1, 0, 1), (1, 1.5, 1.5)),
        ((1, 0, 0, 0), (1, 1, 0, 0), (1, 3)),
        ((1, 0, 0, 0), (0, 1, 1, 1), (2, 2, 2)),
        ((1, 0, 0, 0), (1, 0, 0, 0), (2,)),
        ((1, 1, 0, 0), (0, 1, 1, 1), (2, 1, 1)),
        ((1, 1, 1, 1), (1, 1, 1, 1), (2, 2, 2, 2)),
        ((1, 0, 0, 0), (0, 0, 0, 0), ()),
    ],
)
def test_fingers_without_a_reading_are_stood_in_for_by_those_of_their_side(
    thumb: Any, flags: tuple[int, ...], weights: tuple[float, ...]
) -> None:
    """Each finger presses with a force of its own, so that a sum says who counts how much."""
    press_n = np.array([1.0, 8.0, 64.0, 512.0])
    forces = np.zeros((4, 3))
    forces[:, 2], forces[:, 0], forces[:, 1] = press_n, 3 * press_n, -4 * press_n
    sides = thumb and tuple(map(bool, thumb))
    valid = np.array(flags, dtype=np.bool_)
    sense = sense_of(prediction(), forces.ravel(), valid, sides)
    counted_n = float((press_n[valid] * weights).sum())
    assert (sense.grip_n, sense.load_n) == (counted_n / 2.0, 5.0 * counted_n)


@pytest.mark.parametrize(
    ("force", "grip_n", "load_n"),
    [
        ((0.0, 0.0, 1e9), 0.0, 0.0),
        ((0.0, 0.0, 0.999e9), 0.4995e9, 0.0),
        ((4e8, -4e8, 2e8), 0.0, 0.0),
        ((3.0, 4.0, -0.5), 0.0, 5.0),
        ((3.0, 4.0, 0.5), 0.25, 5.0),
        ((3.0, 4.0, -1e9), 0.0, 0.0),
        ((3.0, np.nan, 1.0), 0.0, 0.0),
    ],
)
def test_a_finger_presses_and_no_reading_is_as_large_as_the_largest(
    force: tuple[float, ...], grip_n: float, load_n: float
) -> None:
    sense = sense_of(prediction(), np.array(force), np.array([True]))
    assert (sense.grip_n, sense.load_n) == (grip_n, load_n)


@pytest.mark.parametrize(
    ("p_risky", "feedback", "reason"),
    [
        (0.0, 0.0, "friction margin"),
        (0.699, 0.0, "friction margin"),
        (0.7, 0.7, "risky slip"),
        (0.8, 0.8, "risky slip"),
    ],
)
def test_the_cue_and_the_reason_begin_where_an_answer_begins(
    p_risky: float, feedback: float, reason: str
) -> None:
    control = held()
    step(control, **RISKY)
    # full evidence fades meanwhile, and the target with it
    command = step(control, p_risky=p_risky)
    assert command.mode in ("tighten", "relax")
    assert (command.feedback, command.reason) == (feedback, reason)
