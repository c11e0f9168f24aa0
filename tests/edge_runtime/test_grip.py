"""The grip controllers: their equations, and the same bits on one hand as on many."""

from __future__ import annotations

from collections.abc import Iterable
from typing import Any

import numpy as np
import pytest
from grip_senses import (
    RATE_HZ,
    bits,
    loop_of,
    numbers_of,
    of_hand,
    of_hands,
    random_senses,
    scripted_senses,
    sense,
    target_of,
)
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.edge_runtime.batch import ONE_HAND, ManyHands, Number
from holdfast.edge_runtime.grip import (
    AnswerRules,
    Controller,
    GripSense,
    Holdfast,
    LoadFollower,
    Want,
    clamped,
)
from holdfast.edge_runtime.grip_control import FrictionMargin, GripLoop
from holdfast.edge_runtime.supervisor import Limits

SAMPLES, HANDS = 80, 3
SOON = AnswerRules(floor=0.13, above=1.25, safe_follow_n=3.0)
"""As a file may have them."""


def after_a_hold(
    setting: float = 8.0,
    rules: AnswerRules | None = None,
    shear_gain: float | None = None,
) -> Controller:
    """The controller after a quiet hold at 3 N that is no longer young; the wearer set 3 N."""
    controller = Holdfast(ONE_HAND, RATE_HZ, setting, rules, shear_gain)
    for _ in range(int(2.5 * RATE_HZ)):
        target_of(controller, sense())
    return controller


def answers_of(
    controller: Controller, *each: dict[str, Any], given_n: float = 0.0
) -> list[float]:
    """What it wants at samples one after another, each given as the controller wanted before."""
    wanted = []
    for changes in each:
        given_n = target_of(controller, sense(**changes), given_n)
        wanted.append(given_n)
    return wanted


# one hand and many


@settings(max_examples=5)
@given(seed=st.integers(0, 2**32 - 1), gain=st.sampled_from([1.0, 1.3]))
def test_controller_margin_and_supervisor_give_one_hand_the_bits_of_many(
    seed: int, gain: float
) -> None:
    many = loop_of(ManyHands(HANDS), gain=gain)
    single = loop_of(ManyHands(1), gain=gain)
    ones = [loop_of(ONE_HAND, gain=gain) for _ in range(HANDS)]
    for senses in random_senses(seed, SAMPLES, HANDS):
        many.step(senses)
        single.step(of_hands(senses, slice(0, 1)))
        for hand, one in enumerate(ones):
            one.step(of_hand(senses, hand))
            assert bits(numbers_of(one)) == bits(numbers_of(many), hand)
        assert bits(numbers_of(single), 0) == bits(numbers_of(many), 0)


def test_no_number_makes_a_nan() -> None:
    loop = loop_of(ManyHands(40))
    for senses in random_senses(3, 150, 40):
        loop.step(senses)
        assert all(np.isfinite(number).all() for number in numbers_of(loop))


@pytest.mark.parametrize("value", [0.0, 5e-324, 1e-300, 3e38])
def test_a_hand_that_senses_one_number_for_ever_gets_a_finite_target(
    value: float,
) -> None:
    for grip_n, load_n in ((value, value), (value, 1.0), (1.0, value)):
        loop = loop_of(ONE_HAND)
        # long enough in a row for the friction margin to see a slide
        for p_risky in ([0.0] * 10 + [1.0] * 10) * 4:
            loop.step(sense(grip_n=grip_n, load_n=load_n, p_risky=p_risky))
            assert np.isfinite(numbers_of(loop)).all()


# each controller


def test_none_wants_nothing_whatever_happens() -> None:
    controller = Controller(ONE_HAND, RATE_HZ)
    want = controller.want(sense(p_risky=1.0, load_n=9.0), 0.0, 0.0, 2.0)
    assert want == Want(0.0, False, 2.0)


@pytest.mark.parametrize("other", [{"known": False}, {"empty": True}])
@pytest.mark.parametrize("why", [{"p_risky": 1.0}, {"load_n": 9.0}])
def test_nothing_is_answered_in_an_unknown_state_or_by_an_empty_hand(
    why: dict[str, Any], other: dict[str, Any]
) -> None:
    controller = after_a_hold()
    want = controller.want(sense(**why, **other), 0.0, 0.0, 2.0)
    assert want == Want(0.0, False, 2.0)


@pytest.mark.parametrize(
    ("p_risky", "share"),
    [(0.0, 0.0), (0.7, 0.0), (0.73, 0.2), (0.775, 0.5), (0.85, 1.0), (1.0, 1.0)],
)
def test_holdfast_leads_the_grip_by_the_evidence(p_risky: float, share: float) -> None:
    (wanted,) = answers_of(after_a_hold(), {"p_risky": p_risky})
    assert wanted == pytest.approx(3.0 + 8.0 * share if share else 0.0)


def test_an_answer_raises_the_grip_by_so_much_and_not_further() -> None:
    controller = after_a_hold(8.0, AnswerRules(rise_n=4.0))
    sure = [{"grip_n": n, "p_risky": 1.0} for n in (3.0, 6.9, 7.1, 9.0)]
    # the wearer's 3 N, and 4 N more
    wanted = [11.0, 14.9, 7.0, 7.0]
    assert answers_of(controller, *sure) == pytest.approx(wanted)


def test_what_friction_needs_is_no_part_of_the_rise() -> None:
    controller = after_a_hold(8.0, AnswerRules(rise_n=4.0))
    firm = sense(grip_n=9.0, p_risky=1.0)
    assert target_of(controller, firm, 5.0, 9.5) == pytest.approx(17.0)
    firm = sense(grip_n=9.6, p_risky=1.0)
    assert target_of(controller, firm, 5.0, 9.5) == pytest.approx(9.5)


BRAKED_N = 3.0 + 2.0 / 16.0
"""The wearer's grip after the sample at 5 N below."""
RISING = {"grip_n": 5.0, "p_risky": 0.775}
"""Half of the evidence: it has faded after four samples."""
FADING_N = [6.0 + 8.0 * (0.5 - n / 9.0) for n in (1, 2, 3, 4)]
"""Targets while it fades and the grip is 6 N: a ninth of all evidence a sample, at 150 Hz."""
FADING = [{"grip_n": 6.0}] * 4


def test_holdfast_goes_on_while_the_evidence_fades_and_then_brakes_and_stays() -> None:
    quiet = [{"grip_n": n} for n in (6.0, 7.0, 7.5, 7.2, 7.1)]
    wanted = answers_of(after_a_hold(), RISING, *FADING, *quiet)
    after = [BRAKED_N, BRAKED_N, BRAKED_N, 7.2, 7.2]
    assert wanted == pytest.approx([9.0, *FADING_N, *after])


def test_holdfast_goes_on_and_brakes_after_an_unknown_state_too() -> None:
    controller = after_a_hold()
    given_n = target_of(controller, sense(**RISING))
    for _ in range(30):
        target_of(controller, sense(known=False), given_n)
    quiet = [{"grip_n": 7.0}] * 5
    wanted = answers_of(controller, *FADING, *quiet, given_n=given_n)
    assert wanted == pytest.approx([*FADING_N, *[BRAKED_N] * 3, 7.0, 7.0])


def test_an_empty_hand_ends_fading_evidence_at_once() -> None:
    controller = after_a_hold()
    wanted = answers_of(controller, RISING, {"empty": True}, {"grip_n": 5.0})
    assert wanted[2] == 0.0


def test_a_sample_that_was_lost_leaves_the_controller_as_it_was() -> None:
    """A loop steps it with an unknown state and no forces, a live run does not step it at all."""
    lost: dict[str, Any] = {"known": False, "grip_n": 0.0, "load_n": 0.0}
    stream: list[dict[str, Any]] = [
        {"load_n": 2.0 + 0.05 * k, "p_safe": 0.8, "p_risky": 0.9 * (k > 3)}
        for k in range(8)
    ]
    whole = answers_of(after_a_hold(), *stream, given_n=5.0)
    for at in range(1, 8):
        controller = after_a_hold()
        before = answers_of(controller, *stream[:at], given_n=5.0)
        target_of(controller, sense(**lost), before[-1])  # the supervisor holds
        after = answers_of(controller, *stream[at:], given_n=before[-1])
        assert [*before, *after] == whole


# the load


def followed(
    loads_n: Iterable[float], rules: AnswerRules | None = None, **changes: Any
) -> list[float]:
    """What a hand at 3 N wants at each load, without a target before; used so far: none."""
    controller = after_a_hold(rules=rules)
    wanted = []
    for load_n in loads_n:
        wanted.append(target_of(controller, sense(load_n=load_n, **changes)))
    return wanted


@pytest.mark.parametrize("rate_n_s", [0.0, 1.5, 3.0, 6.0])
def test_the_grip_follows_the_load_that_will_be_there_when_the_drive_has_come(
    rate_n_s: float,
) -> None:
    """3 N a side and a floor of 0.2: of 6 N both sides, 0.23 times 6 N may be in use."""
    rules = AnswerRules(floor=0.2, above=1.15, follow_n=99.0)
    loads_n = 2.0 + rate_n_s * (np.arange(60) - 60) / RATE_HZ
    wanted_n = followed(loads_n, rules)[-1]
    comes_n = loads_n[-1] + LoadFollower.AHEAD_S * rate_n_s
    assert wanted_n == pytest.approx(comes_n / 0.46, rel=1e-3)


def test_a_load_is_followed_while_a_fifth_more_than_that_is_in_use() -> None:
    starts_n = LoadFollower.STARTS * 1.15 * 0.2 * 6.0
    rules = AnswerRules(floor=0.2, above=1.15)
    wanted = followed([0.0, 1.2, starts_n - 0.01, starts_n + 0.01], rules)
    assert wanted[:3] == [0.0, 0.0, 0.0]
    assert wanted[3] > 3.0


def test_the_floor_is_a_share_of_friction_whatever_a_sensor_reads() -> None:
    """0.3 as read at 0.6 are 0.5 of friction; 1.5 times it, of 6 N, are 4.5 N along the skin."""
    rules = AnswerRules(floor=0.3, above=1.25)
    for gain in (0.3, 0.6, 1.0, 1.5):
        controller = after_a_hold(rules=rules, shear_gain=gain)
        assert target_of(controller, sense(load_n=4.45 * gain)) == 0.0
        assert target_of(controller, sense(load_n=4.55 * gain)) > 3.0
        # a load that stays: 1.25 times the floor may be in use
        controller = after_a_hold(rules=rules, shear_gain=gain)
        for _ in range(round(RATE_HZ)):
            wanted_n = target_of(controller, sense(load_n=8.0 * gain), 5.0)
        assert wanted_n == pytest.approx(8.0 / (2.0 * 1.25 * 0.5))
    # as at 0.6
    unknown = after_a_hold(rules=AnswerRules(floor=0.3, above=1.25))
    assert target_of(unknown, sense(load_n=2.6)) == 0.0
    assert target_of(unknown, sense(load_n=2.8)) > 3.0


def test_a_load_that_stays_becomes_usual_and_is_not_followed() -> None:
    rules = AnswerRules(floor=0.2)
    controller = after_a_hold(rules=rules)
    slowly = np.linspace(0.0, 3.0, round(10 * RATE_HZ))
    assert not any(target_of(controller, sense(load_n=n)) for n in slowly)
    assert target_of(controller, sense(load_n=3.0)) == 0.0
    assert target_of(controller, sense(load_n=5.5)) > 3.0


def test_what_was_in_use_under_a_target_or_unknown_is_not_usual() -> None:
    rules = AnswerRules(floor=0.2)
    # of a load that no one knew before, much more is still to come
    for changes, given_n, wanted_n in (
        ({}, 5.0, 3.0 / 0.46),
        ({"known": False}, 0.0, 9.0),
    ):
        controller = after_a_hold(rules=rules)
        for _ in range(600):
            target_of(controller, sense(load_n=3.0, **changes), given_n)
        found_n = target_of(controller, sense(load_n=3.0))
        assert found_n == pytest.approx(wanted_n)


def test_the_next_object_is_another_one() -> None:
    rules = AnswerRules(floor=0.2)
    controller = after_a_hold(rules=rules)
    for n in np.linspace(0.0, 3.0, round(10 * RATE_HZ)):
        target_of(controller, sense(load_n=n))
    target_of(controller, sense(empty=True))
    for _ in range(round(2 * RATE_HZ)):
        assert target_of(controller, sense()) == 0.0
    assert target_of(controller, sense(load_n=3.0)) > 0.0


@pytest.mark.parametrize("rules", [AnswerRules(), SOON])
def test_a_pick_up_is_no_slip(rules: AnswerRules) -> None:
    """Grip and load rise together, to a third of friction, as people lift."""
    controller = Holdfast(ONE_HAND, RATE_HZ, rules=rules)
    target_of(controller, sense(empty=True))
    for k in range(round(1.5 * RATE_HZ)):
        made = min(1.0, k / (0.35 * RATE_HZ))
        lifted = sense(grip_n=6.0 * made, load_n=4.0 * made)
        assert target_of(controller, lifted) == 0.0
    # and what is more than this hold has is one
    assert target_of(controller, sense(grip_n=6.0, load_n=7.0)) > 6.0


def test_a_hold_grows_older_while_its_state_is_unknown() -> None:
    """Half a second of it is unknown, as after lost samples; then the object begins to slide."""
    controller = Holdfast(ONE_HAND, RATE_HZ)
    target_of(controller, sense(empty=True))
    for seconds, known in ((0.7, True), (0.5, False), (0.2, True)):
        for _ in range(round(seconds * RATE_HZ)):
            hold = sense(grip_n=3.0, load_n=1.0, known=known)
            assert target_of(controller, hold) == 0.0
    slides = sense(grip_n=3.0, load_n=2.0, p_risky=1.0)
    assert target_of(controller, slides) > 3.0 + controller.EARLY_N


def test_a_pick_up_by_fingers_that_rested_on_the_object_is_no_slip() -> None:
    """Fingers lie on the object for two seconds, and the load is felt before the grip grows."""
    loop = GripLoop(ONE_HAND, RATE_HZ, Holdfast(ONE_HAND, RATE_HZ, rules=SOON))
    for _ in range(round(2 * RATE_HZ)):
        assert loop.step(sense(grip_n=0.2, load_n=0.02)) == 0.0
    for k in range(round(1.5 * RATE_HZ)):
        made = min(1.0, k / (0.2 * RATE_HZ))
        grip_n = 0.2 + 6.0 * max(0.0, made - 0.1)
        target_n = loop.step(sense(grip_n=grip_n, load_n=4.0 * made))
        assert target_n <= grip_n + 1.5
    assert target_n == 0.0


def test_a_load_is_followed_by_a_little_more_than_twice_the_wearers_grip() -> None:
    rules = AnswerRules(floor=0.2, follow_n=15.0)
    assert followed([99.0], rules) == pytest.approx([3.0 + 1.0 + 6.0])
    assert followed([99.0], AnswerRules(floor=0.2)) == pytest.approx([3.0 + 6.0])


def test_a_slow_load_is_followed_before_half_of_it_is_there() -> None:
    controller = after_a_hold(rules=SOON)
    loads_n = np.linspace(0.5, 4.0, round(1.2 * RATE_HZ))
    wanted = [target_of(controller, sense(load_n=n)) for n in loads_n]
    assert wanted[len(wanted) // 2] > 3.0


# a young hold


def early_answer(held_s: float, load_n: float) -> float:
    """What is wanted over a wearer's grip of 3 N at a certain slip, so long after the contact.

    Usual is a load of 1 N. The lead is 8 N.
    """
    controller = Holdfast(ONE_HAND, RATE_HZ, 8.0)
    target_of(controller, sense(empty=True))
    for _ in range(round(held_s * RATE_HZ)):
        target_of(controller, sense(load_n=1.0))
    wanted_n = target_of(controller, sense(load_n=load_n, p_risky=1.0))
    return float(wanted_n) - 3.0 if wanted_n else 0.0


def test_in_a_young_hold_a_slip_counts_as_far_as_more_friction_is_in_use() -> None:
    assert early_answer(1.6, 0.9) == 0.0
    assert 1.0 < early_answer(1.6, 1.15) < 4.0 < early_answer(1.6, 1.3) < 8.0
    assert early_answer(1.6, 1.5) == pytest.approx(8.0)
    assert early_answer(2.2, 0.9) == pytest.approx(8.0)


def test_soon_after_the_contact_a_target_is_a_little_over_the_wearers_grip() -> None:
    assert early_answer(0.5, 3.0) == 0.0
    assert early_answer(0.8, 3.0) == pytest.approx(2.0, abs=0.01)
    assert early_answer(1.1, 3.0) == pytest.approx(2.0, abs=0.01)
    assert early_answer(1.3, 3.0) == pytest.approx(8.0)


# the wearer's grip


def closed(
    grip_n: float,
    lasts_s: float,
    given_from_s: float,
    most_over_n: float,
    gain: float = 1.0,
) -> tuple[float, float]:
    """(largest target, the wearer's grip as measured) where a hand closes with a slip certain.

    The hand grips for the larger of the target and its wearer, behind a lag of 50 ms. gain: read
    over true.
    """
    rules = AnswerRules(most_over_n=most_over_n)
    loop = GripLoop(ONE_HAND, RATE_HZ, Holdfast(ONE_HAND, RATE_HZ, rules=rules))
    own_n = held_n = largest_n = 0.0
    for k in range(round(2.5 * RATE_HZ)):
        t_s = k / RATE_HZ
        u = min(1.0, t_s / lasts_s)
        own_n = grip_n * u * u * u * (10.0 + u * (6.0 * u - 15.0))
        target_n = loop.supervisor.given_n
        held_n += (max(own_n, target_n) - held_n) / (1.0 + 0.05 * RATE_HZ)
        slips = given_from_s <= t_s < given_from_s + 0.3
        loop.step(
            sense(
                grip_n=gain * max(own_n, held_n),
                p_risky=1.0 if slips else 0.0,
                empty=own_n < 0.05,
            )
        )
        largest_n = max(largest_n, loop.supervisor.given_n)
    return largest_n, loop.controller.wearers_n


@pytest.mark.parametrize("lasts_s", [0.2, 0.5, 0.8])
@pytest.mark.parametrize("grip_n", [1.0, 5.0, 24.0])
def test_a_slip_at_any_time_of_the_close_leaves_the_wearers_grip_known(
    grip_n: float, lasts_s: float
) -> None:
    for given_from_s in np.arange(0.02, 1.2, 0.12):
        largest_n, measured_n = closed(grip_n, lasts_s, given_from_s, 3.0)
        assert measured_n == pytest.approx(grip_n, abs=1.0)
        assert largest_n <= grip_n + 3.0 + 1.0


@pytest.mark.parametrize("gain", [1.3, 2.4])
def test_a_sensor_that_reads_too_much_makes_no_target_climb(gain: float) -> None:
    """What it reads under a target was more than the target, and was taken for the wearer's."""
    for given_from_s in np.arange(0.02, 1.2, 0.12):
        largest_n, measured_n = closed(5.0, 0.5, given_from_s, 3.0, gain)
        assert measured_n == pytest.approx(gain * 5.0, abs=1.0)
        assert largest_n <= gain * 5.0 + 3.0 + 1.0


def test_a_hand_that_only_closes_wants_nothing_however_its_load_is_read() -> None:
    """A tilted sensor reads a part of the grip as a load that grows with it."""
    for tilt in (0.0, 0.2, 0.5):
        controller = Holdfast(ONE_HAND, RATE_HZ, rules=SOON)
        target_of(controller, sense(empty=True))
        for k in range(round(2 * RATE_HZ)):
            grip_n = 25.0 * min(1.0, k / (0.9 * RATE_HZ))
            one = sense(grip_n=grip_n, load_n=0.1 + 2.0 * tilt * grip_n)
            assert target_of(controller, one) == 0.0


def test_a_tremor_is_usual_after_a_while() -> None:
    rules = AnswerRules(floor=0.2)
    controller = after_a_hold(rules=rules)
    t_s = np.arange(round(4 * RATE_HZ)) / RATE_HZ
    loads_n = 1.0 + 0.8 * np.sin(2.0 * np.pi * 6.0 * t_s)
    wanted = [target_of(controller, sense(load_n=n)) for n in loads_n]
    assert any(wanted[:60])
    assert not any(wanted[450:])


def test_a_load_that_another_person_takes_is_not_followed_or_by_so_much() -> None:
    assert followed([3.0], p_safe=0.6) == [0.0]
    assert followed([3.0], p_safe=0.4) != [0.0]
    rules = AnswerRules(floor=0.2, safe_follow_n=2.0)
    assert followed([3.0], rules, p_safe=0.6) == pytest.approx([5.0])


def test_a_load_is_followed_by_so_much_and_not_further() -> None:
    rules = AnswerRules(floor=0.2, follow_n=3.0)
    assert followed([3.0, 9.0], rules) == pytest.approx([6.0, 6.0])
    # a slip is answered all the same
    assert followed([9.0], rules, p_risky=1.0) == pytest.approx([11.0])


def test_no_target_is_further_above_the_wearers_grip_than_allowed() -> None:
    rules = AnswerRules(most_over_n=2.0)
    assert followed([9.0], rules) == pytest.approx([5.0])
    assert followed([0.0], rules, p_risky=1.0) == pytest.approx([5.0])


def test_the_larger_of_both_answers_counts() -> None:
    rules = AnswerRules(floor=0.2)
    assert followed([3.0], rules, p_risky=0.73) == pytest.approx([3.0 + 6.0])
    assert followed([1.5], rules, p_risky=0.85) == pytest.approx([3.0 + 8.0])


def test_holdfast_raises_to_what_friction_needs_only_where_it_has_answered() -> None:
    controller = after_a_hold(8.0)
    assert target_of(controller, sense(), 7.0, 9.0) == 9.0
    assert target_of(controller, sense(), 0.0, 9.0) == 0.0


class NineNewtons(Controller):
    """A grip rule as another person may write it: 9 N from a slip on, and 4 N are kept."""

    def want(
        self, sense: GripSense, given_n: Number, needed_n: Number, holds_n: Number
    ) -> Want:
        slips = sense.p_risky > 0.5
        return Want(self._batch.choose(slips, 9.0, given_n), slips, 4.0)


def test_a_rule_of_one_method_is_given_back_to_the_grip_that_it_keeps() -> None:
    loop = loop_of(ONE_HAND, NineNewtons)
    assert loop.step(sense(p_risky=1.0)) == 9.0
    given_n = [loop.step(sense()) for _ in range(round(RATE_HZ))]
    assert given_n[0] == 9.0
    assert min(given_n) == given_n[-1] == 4.0


# a whole stream, number by number


@pytest.mark.parametrize(
    ("rules", "total_n", "each_n"),
    [
        (
            AnswerRules(floor=0.2),
            2748.714577,
            "0 4.9910975 5.6366436 4.0270932 0 0 0 15.029909 0 0 0",
        ),
        (
            AnswerRules(detects=False, floor=0.05, above=1.002),
            2252.049075,
            "0 4.9910975 5.0323088 3.8929998 0 0 0 8.6899277 7.9899277 0 0",
        ),
        (
            AnswerRules(follows=False, rise_n=2.0),
            1878.475216,
            "0 0 0 0 0 0 0 15.029909 0 0 0",
        ),
    ],
)
def test_a_whole_stream_is_answered_by_the_formulas(
    rules: AnswerRules, total_n: float, each_n: str
) -> None:
    """The sum of all targets of the scripted senses, and every 70th from the 130th on."""
    limits = Limits(20.0, most_rise_s=0.1, give_back_s=0.2, give_back_n_s=5.0)
    controller = Holdfast(ONE_HAND, RATE_HZ, rules=rules, shear_gain=1.1)
    loop = GripLoop(ONE_HAND, RATE_HZ, controller, limits)
    targets_n = [loop.step(one) for one in scripted_senses()]
    assert sum(targets_n) == pytest.approx(total_n, abs=1e-4)
    each = [float(one) for one in each_n.split()]
    assert targets_n[130::70] == pytest.approx(each, abs=1e-5)


def test_the_friction_margin_follows_a_whole_stream() -> None:
    margin = FrictionMargin(ONE_HAND, RATE_HZ, 1.1)
    rows = []
    for one in scripted_senses():
        margin.step(one)
        numbers = (margin.mu_hat, margin.needed_n, margin.holds_n)
        rows.append([*numbers, margin.margin, margin.held])
    assert np.sum(rows, axis=0).tolist() == pytest.approx(
        [279.141115, 1864.010156, 2767.160062, 175.255871, 297.703251], abs=1e-5
    )
    assert rows[250] == pytest.approx(
        [0.437525, 4.874348, 4.874348, 0.029215, 0.401735], abs=1e-6
    )


@pytest.mark.parametrize("name", ["grip_n", "load_n", "p_risky", "p_safe"])
def test_a_sample_with_a_number_that_is_none_is_unknown(name: str) -> None:
    assert not clamped(ONE_HAND, sense(**{name: float("nan")})).known
    many = clamped(ManyHands(2), sense(**{name: np.array([np.nan, 0.5])}))
    assert many.known.tolist() == [False, True]
    beyond = sense(grip_n=2e9, load_n=-1.0, p_risky=1.5, p_safe=-0.1)
    one = clamped(ONE_HAND, beyond)
    assert (one.grip_n, one.load_n, one.p_risky, one.p_safe) == (1e9, 0.0, 1.0, 0.0)
    assert one.known
