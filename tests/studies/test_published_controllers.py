"""The published controllers: their equations, and the same bits on one hand as on many."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from grip_senses import (
    RATE_HZ,
    bits,
    loop_of,
    numbers_of,
    of_hand,
    random_senses,
    scripted_senses,
    sense,
    target_of,
)

from holdfast.edge_runtime.batch import ONE_HAND, ManyHands
from holdfast.edge_runtime.grip import Controller, Want
from holdfast.edge_runtime.grip_control import GripLoop
from studies.shared_control.published import (
    CONTROLLERS,
    PdShear,
    SlidingMode,
    SlipIntegral,
    SlipSteps,
)

HANDS = 3


def after_a_hold(kind: type[Controller], setting: float | None = None) -> Controller:
    """A controller after two seconds of a quiet hold at 3 N; the wearer set 3 N."""
    controller = kind(ONE_HAND, RATE_HZ, setting)
    for _ in range(int(2 * RATE_HZ)):
        target_of(controller, sense())
    return controller


def answers_of(controller: Controller, *each: dict[str, Any]) -> list[float]:
    """What it wants at samples one after another, each given as the controller wanted before."""
    wanted = []
    given_n = 0.0
    for changes in each:
        given_n = target_of(controller, sense(**changes), given_n)
        wanted.append(given_n)
    return wanted


@pytest.mark.parametrize("kind", CONTROLLERS.values(), ids=CONTROLLERS)
def test_one_hand_has_the_bits_of_many(kind: type[Controller]) -> None:
    many = loop_of(ManyHands(HANDS), kind)
    ones = [loop_of(ONE_HAND, kind) for _ in range(HANDS)]
    for senses in random_senses(5, 80, HANDS):
        many.step(senses)
        for hand, one in enumerate(ones):
            one.step(of_hand(senses, hand))
            assert bits(numbers_of(one)) == bits(numbers_of(many), hand)
        assert all(np.isfinite(number).all() for number in numbers_of(many))


def test_pd_shear_adds_the_load_above_its_threshold_and_its_rate() -> None:
    controller, kp, kd = after_a_hold(PdShear, 2.0), 2.0, 2.0 * PdShear.RATE_S
    first = target_of(controller, sense(load_n=2.0))
    second = target_of(controller, sense(load_n=2.0), first)
    assert first == pytest.approx(3.0 + kp * (2.0 - 1.0) + kd * 1.5 * RATE_HZ)
    assert second == pytest.approx(3.0 + kp * (2.0 - 1.0))


def test_pd_shear_wants_nothing_under_its_threshold_or_with_an_empty_hand() -> None:
    assert answers_of(after_a_hold(PdShear), {"load_n": 1.0}) == [0.0]
    assert answers_of(after_a_hold(PdShear), {"load_n": 5.0, "empty": True}) == [0.0]


def test_sliding_mode_pushes_back_to_the_wearers_grip_and_saturates() -> None:
    controller = after_a_hold(SlidingMode, 2.0)
    wanted = [target_of(controller, sense(grip_n=n), 3.0) for n in (3.0, 2.5, 0.5, 6.0)]
    wearers_n = wanted[2] - 2.0  # saturated
    assert wearers_n == pytest.approx(
        3.0, rel=0.01
    )  # 0.1 s of averaging, half a second after contact
    assert wanted == pytest.approx(
        [wearers_n + 2.0 * x for x in (wearers_n - 3.0, wearers_n - 2.5, 1.0, -1.0)]
    )


def test_sliding_mode_knows_no_slip_and_waits_for_half_a_second_of_contact() -> None:
    controller = SlidingMode(ONE_HAND, RATE_HZ)
    waits = int(0.5 * RATE_HZ) - 1
    wanted = [target_of(controller, sense(p_risky=1.0)) for _ in range(waits)]
    assert not any(wanted)
    target_of(controller, sense())
    assert target_of(controller, sense()) > 0.0


def test_smsp_adds_one_step_for_every_slip_event_however_long_it_lasts() -> None:
    slips = [{"p_risky": p} for p in (0.9, 0.6, 1.0, 0.4, 0.9, 0.9)]
    wanted = answers_of(after_a_hold(SlipSteps, 3.0), *slips)
    assert wanted == pytest.approx([6.0, 6.0, 6.0, 6.0, 9.0, 9.0], abs=1e-6)


def test_ismsp_integrates_the_slip_signal() -> None:
    slips = [{"p_risky": p} for p in (0.6, 0.9, 0.4, 0.0, 0.9)]
    step_n = 60.0 / RATE_HZ
    wanted = np.array(answers_of(after_a_hold(SlipIntegral, 60.0), *slips)) - 3.0
    assert wanted / step_n == pytest.approx([1.0, 2.0, 2.0, 2.0, 3.0], abs=1e-6)


@pytest.mark.parametrize("kind", [SlipSteps, SlipIntegral])
@pytest.mark.parametrize("other", [{"known": False}, {"grip_n": 0.4}])
def test_no_slip_is_answered_in_an_unknown_state_or_without_a_firm_grip(
    kind: type[Controller], other: dict[str, Any]
) -> None:
    controller = after_a_hold(kind)
    want = controller.want(sense(**({"p_risky": 1.0} | other)), 0.0, 0.0, 2.0)
    assert want == Want(0.0, False, 2.0)


TARGETS_N = {
    "none": 0.0,
    "pd-shear": 2487.653090,
    "sliding-mode": 1345.986860,
    "smsp": 5098.751004,
    "ismsp": 34311.039732,
}
"""Sum of all targets of the scripted senses, N a side."""


@pytest.mark.parametrize("name", TARGETS_N)
def test_each_controller_answers_a_whole_stream_by_its_formulas(name: str) -> None:
    controller = CONTROLLERS[name](ONE_HAND, RATE_HZ, shear_gain=1.1)
    loop = GripLoop(ONE_HAND, RATE_HZ, controller)
    targets_n = [loop.step(one) for one in scripted_senses()]
    assert sum(targets_n) == pytest.approx(TARGETS_N[name], abs=1e-4)
