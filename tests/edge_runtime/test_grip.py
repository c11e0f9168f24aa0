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
)
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.errors import UsageError
from holdfast.edge_runtime.batch import ONE_HAND, ManyHands
from holdfast.edge_runtime.grip import (
    CONTROLLERS,
    AnswerRules,
    Controller,
    Holdfast,
    LoadSwing,
    PdShear,
    possible,
)
from holdfast.edge_runtime.grip_control import (
    FrictionMargin,
    GripLoop,
    controller_of,
)
from holdfast.edge_runtime.supervisor import Limits

SAMPLES, HANDS = 80, 3
EVERY = sorted(CONTROLLERS)


def after_a_hold(
    name: str, setting: float | None = None, rules: AnswerRules | None = None
) -> Controller:
    """A controller after two seconds of a quiet hold at 3 N; the wearer set 3 N."""
    controller = controller_of(name, ONE_HAND, RATE_HZ, setting)
    if rules is not None:
        controller = Holdfast(ONE_HAND, RATE_HZ, setting or Holdfast.SETTING, rules)
    for _ in range(int(2 * RATE_HZ)):
        controller.want(sense(), 0.0, 0.0)
    return controller


def answers_of(
    controller: Controller, *each: dict[str, Any], given_n: float = 0.0
) -> list[float]:
    """What it wants at samples one after another, each given as the controller wanted before."""
    wanted = []
    for changes in each:
        given_n = controller.want(sense(**changes), given_n, 0.0)
        wanted.append(given_n)
    return wanted


# one hand and many


@pytest.mark.parametrize("name", EVERY)
@settings(max_examples=3)
@given(seed=st.integers(0, 2**32 - 1), gain=st.sampled_from([1.0, 1.3]))
def test_controller_margin_and_supervisor_give_one_hand_the_bits_of_many(
    name: str, seed: int, gain: float
) -> None:
    many = loop_of(ManyHands(HANDS), name, gain)
    single = loop_of(ManyHands(1), name, gain)
    ones = [loop_of(ONE_HAND, name, gain) for _ in range(HANDS)]
    for senses in random_senses(seed, SAMPLES, HANDS):
        many.step(senses)
        single.step(of_hands(senses, slice(0, 1)))
        for hand, one in enumerate(ones):
            one.step(of_hand(senses, hand))
            assert bits(numbers_of(one)) == bits(numbers_of(many), hand)
        assert bits(numbers_of(single), 0) == bits(numbers_of(many), 0)


@pytest.mark.parametrize("name", EVERY)
def test_no_number_makes_a_nan(name: str) -> None:
    loop = loop_of(ManyHands(40), name)
    for senses in random_senses(3, 150, 40):
        loop.step(senses)
        assert all(np.isfinite(number).all() for number in numbers_of(loop))


@pytest.mark.parametrize("name", EVERY)
@pytest.mark.parametrize("value", [0.0, 5e-324, 1e-300, 3e38])
def test_a_hand_that_senses_one_number_for_ever_gets_a_finite_target(
    name: str, value: float
) -> None:
    for grip_n, load_n in ((value, value), (value, 1.0), (1.0, value)):
        loop = loop_of(ONE_HAND, name)
        # long enough in a row for the friction margin to see a slide
        for p_risky in ([0.0] * 10 + [1.0] * 10) * 4:
            loop.step(sense(grip_n=grip_n, load_n=load_n, p_risky=p_risky))
            assert np.isfinite(numbers_of(loop)).all()


# each controller


def test_none_wants_nothing_whatever_happens() -> None:
    controller = after_a_hold("none")
    assert answers_of(controller, {"p_risky": 1.0, "load_n": 9.0}) == [0.0]
    assert not controller.fresh


def test_pd_shear_adds_the_load_above_its_threshold_and_its_rate() -> None:
    controller, kp, kd = after_a_hold("pd-shear", 2.0), 2.0, 2.0 * PdShear.RATE_S
    first = controller.want(sense(load_n=2.0), 0.0, 0.0)
    second = controller.want(sense(load_n=2.0), first, 0.0)
    assert first == pytest.approx(3.0 + kp * (2.0 - 1.0) + kd * 1.5 * RATE_HZ)
    assert second == pytest.approx(3.0 + kp * (2.0 - 1.0))


def test_pd_shear_wants_nothing_under_its_threshold_or_with_an_empty_hand() -> None:
    assert answers_of(after_a_hold("pd-shear"), {"load_n": 1.0}) == [0.0]
    assert answers_of(after_a_hold("pd-shear"), {"load_n": 5.0, "empty": True}) == [0.0]


def test_sliding_mode_pushes_back_to_the_wearers_grip_and_saturates() -> None:
    controller = after_a_hold("sliding-mode", 2.0)
    wanted = [controller.want(sense(grip_n=n), 3.0, 0.0) for n in (3.0, 2.5, 0.5, 6.0)]
    wearers_n = wanted[2] - 2.0  # saturated
    assert wearers_n == pytest.approx(
        3.0, rel=0.01
    )  # 0.1 s of averaging, half a second after contact
    assert wanted == pytest.approx(
        [wearers_n + 2.0 * x for x in (wearers_n - 3.0, wearers_n - 2.5, 1.0, -1.0)]
    )


def test_sliding_mode_knows_no_slip_and_waits_for_half_a_second_of_contact() -> None:
    controller = controller_of("sliding-mode", ONE_HAND, RATE_HZ)
    waits = int(0.5 * RATE_HZ) - 1
    wanted = [controller.want(sense(p_risky=1.0), 0.0, 0.0) for _ in range(waits)]
    assert not any(wanted)
    controller.want(sense(), 0.0, 0.0)
    assert controller.want(sense(), 0.0, 0.0) > 0.0


def test_smsp_adds_one_step_for_every_slip_event_however_long_it_lasts() -> None:
    slips = [{"p_risky": p} for p in (0.9, 0.6, 1.0, 0.4, 0.9, 0.9)]
    wanted = answers_of(after_a_hold("smsp", 3.0), *slips)
    assert wanted == pytest.approx([6.0, 6.0, 6.0, 6.0, 9.0, 9.0], abs=1e-6)


def test_ismsp_integrates_the_slip_signal() -> None:
    slips = [{"p_risky": p} for p in (0.6, 0.9, 0.4, 0.0, 0.9)]
    step_n = 60.0 / RATE_HZ
    wanted = np.array(answers_of(after_a_hold("ismsp", 60.0), *slips)) - 3.0
    assert wanted / step_n == pytest.approx([1.0, 2.0, 2.0, 2.0, 3.0], abs=1e-6)


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("smsp", {"known": False}),
        ("smsp", {"grip_n": 0.4}),
        ("ismsp", {"known": False}),
        ("ismsp", {"grip_n": 0.4}),
        ("holdfast", {"known": False}),
        ("holdfast", {"empty": True}),
    ],
)
def test_no_slip_is_answered_in_an_unknown_state_or_without_a_firm_grip(
    name: str, other: dict[str, Any]
) -> None:
    controller = after_a_hold(name)
    assert answers_of(controller, {"p_risky": 1.0} | other) == [0.0]
    assert not controller.fresh


@pytest.mark.parametrize(
    ("p_risky", "share"),
    [(0.0, 0.0), (0.7, 0.0), (0.73, 0.2), (0.775, 0.5), (0.85, 1.0), (1.0, 1.0)],
)
def test_holdfast_leads_the_grip_by_the_evidence(p_risky: float, share: float) -> None:
    (wanted,) = answers_of(after_a_hold("holdfast", 8.0), {"p_risky": p_risky})
    assert wanted == pytest.approx(3.0 + 8.0 * share if share else 0.0)


def test_an_answer_raises_the_grip_by_so_much_and_not_further() -> None:
    controller = after_a_hold("holdfast", 8.0, AnswerRules(rise_n=4.0))
    sure = [{"grip_n": n, "p_risky": 1.0} for n in (3.0, 6.9, 7.1, 9.0)]
    # the wearer's 3 N, and 4 N more
    wanted = [11.0, 14.9, 7.0, 7.0]
    assert answers_of(controller, *sure) == pytest.approx(wanted)


def test_what_friction_needs_is_no_part_of_the_rise() -> None:
    controller = after_a_hold("holdfast", 8.0, AnswerRules(rise_n=4.0))
    firm = sense(grip_n=9.0, p_risky=1.0)
    assert controller.want(firm, 5.0, needed_n=9.5) == pytest.approx(17.0)
    firm = sense(grip_n=9.6, p_risky=1.0)
    assert controller.want(firm, 5.0, needed_n=9.5) == pytest.approx(9.5)


def test_holdfast_without_grading_answers_fully_or_not_at_all() -> None:
    controller = after_a_hold("holdfast", 8.0, AnswerRules(graded=False))
    wanted = [controller.want(sense(p_risky=p), 0.0, 0.0) for p in (0.77, 0.78)]
    assert wanted == pytest.approx([0.0, 11.0])


BRAKED_N = 3.0 + 2.0 / 16.0
"""The wearer's grip after the sample at 5 N below."""
RISING = {"grip_n": 5.0, "p_risky": 0.775}
"""Half of the evidence: it has faded after four samples."""
FADING_N = [6.0 + 8.0 * (0.5 - n / 9.0) for n in (1, 2, 3, 4)]
"""Targets while it fades and the grip is 6 N: a ninth of all evidence a sample, at 150 Hz."""
FADING = [{"grip_n": 6.0}] * 4


def test_holdfast_goes_on_while_the_evidence_fades_and_then_brakes_and_stays() -> None:
    quiet = [{"grip_n": n} for n in (6.0, 7.0, 7.5, 7.2, 7.1)]
    wanted = answers_of(after_a_hold("holdfast", 8.0), RISING, *FADING, *quiet)
    after = [BRAKED_N, BRAKED_N, BRAKED_N, 7.2, 7.2]
    assert wanted == pytest.approx([9.0, *FADING_N, *after])


def test_holdfast_goes_on_and_brakes_after_an_unknown_state_too() -> None:
    controller = after_a_hold("holdfast", 8.0)
    given_n = controller.want(sense(**RISING), 0.0, 0.0)
    for _ in range(30):
        controller.want(sense(known=False), given_n, 0.0)
    quiet = [{"grip_n": 7.0}] * 5
    wanted = answers_of(controller, *FADING, *quiet, given_n=given_n)
    assert wanted == pytest.approx([*FADING_N, *[BRAKED_N] * 3, 7.0, 7.0])


def test_an_empty_hand_ends_fading_evidence_at_once() -> None:
    controller = after_a_hold("holdfast", 8.0)
    wanted = answers_of(controller, RISING, {"empty": True}, {"grip_n": 5.0})
    assert wanted[2] == pytest.approx(BRAKED_N)


@pytest.mark.parametrize("name", EVERY)
def test_a_sample_that_was_lost_leaves_the_controller_as_it_was(name: str) -> None:
    """A loop steps it with an unknown state and no forces, a live run does not step it at all."""
    lost: dict[str, Any] = {"known": False, "grip_n": 0.0, "load_n": 0.0}
    stream: list[dict[str, Any]] = [
        {"load_n": 2.0 + 0.05 * k, "p_safe": 0.8, "p_risky": 0.9 * (k > 3)}
        for k in range(8)
    ]
    whole = answers_of(after_a_hold(name), *stream, given_n=5.0)
    for at in range(1, 8):
        controller = after_a_hold(name)
        before = answers_of(controller, *stream[:at], given_n=5.0)
        controller.want(sense(**lost), before[-1], 0.0)  # the supervisor holds
        after = answers_of(controller, *stream[at:], given_n=before[-1])
        assert [*before, *after] == whole


def held_for(
    loads_n: Iterable[float], p_safe: float = 0.9, before_n: Iterable[float] = ()
) -> list[float]:
    """What a tightened hand wants at each load; before_n: loads before, without a safe slip."""
    controller = after_a_hold("holdfast")
    for load_n in [*[3.0] * 300, *before_n]:
        controller.want(sense(load_n=load_n), 8.0, 0.0)
    changes = [{"p_safe": p_safe, "load_n": load_n} for load_n in loads_n]
    return answers_of(controller, *changes, given_n=8.0)


def ramp(to_n: float, lasts_s: float) -> list[float]:
    """From 3 N on, at every sample."""
    return np.linspace(3.0, to_n, round(lasts_s * RATE_HZ)).tolist()


def trembling(size_n: float, frequency_hz: float, lasts_s: float) -> list[float]:
    """Two close frequencies about 3 N, so that the tremor waxes and wanes."""
    t_s = np.arange(round(lasts_s * RATE_HZ)) / RATE_HZ
    waves = [np.sin(2.0 * np.pi * f * frequency_hz * t_s) for f in (0.9, 1.1)]
    swing: list[float] = (3.0 + 0.5 * size_n * (waves[0] + waves[1])).tolist()
    return swing


def gives_back(wanted: list[float]) -> bool:
    """Whether the hand gave its grip back; else it kept all of it."""
    assert wanted[-1] == 0.0 or set(wanted) == {8.0}
    return wanted[-1] == 0.0


def test_holdfast_gives_back_where_another_person_takes_the_weight() -> None:
    assert gives_back(held_for(ramp(0.0, 0.3)))
    assert not gives_back(held_for(ramp(0.0, 0.3), p_safe=0.4))


@pytest.mark.parametrize("lasts_s", [0.05, 0.3, 2.0])
def test_holdfast_keeps_the_grip_while_a_pull_adds_load(lasts_s: float) -> None:
    assert not gives_back(held_for(ramp(9.0, lasts_s)))


def test_holdfast_keeps_the_grip_in_a_static_hold_and_while_something_is_poured() -> (
    None
):
    assert not gives_back(held_for([3.0] * 300))
    assert not gives_back(held_for(ramp(0.9, 4.0)))
    noise = 0.03 * np.random.default_rng(0).normal(size=600)
    assert not gives_back(held_for((3.0 + noise).tolist()))


@pytest.mark.parametrize("frequency_hz", [4.5, 8.0, 11.0])
@pytest.mark.parametrize("size_n", [0.3, 0.9, 2.0])
def test_a_tremor_is_no_hand_over_however_large_and_does_not_hide_one(
    frequency_hz: float, size_n: float
) -> None:
    whole = trembling(size_n, frequency_hz, 5.0)
    before, after = whole[:300], whole[300:]
    assert not gives_back(held_for(after, before_n=before))
    # taken within 0.3 s, tremor and all; the answer may take a period longer
    shares = np.clip(1.0 - np.arange(90) / 45.0, 0.0, 1.0)
    taken = (shares * np.array(after[:90])).tolist()
    assert gives_back(held_for(taken, before_n=before))


def test_a_pull_that_adds_load_and_then_takes_it_ends_the_answer_as_it_takes() -> None:
    pulled = [*ramp(5.0, 0.2), *np.linspace(5.0, 0.0, 30).tolist()]
    wanted = held_for(pulled)
    assert 0.2 * RATE_HZ < wanted.index(0.0) < 0.35 * RATE_HZ


def test_what_the_load_did_before_a_lost_sample_is_not_forgotten() -> None:
    controller = after_a_hold("holdfast")
    before = trembling(2.0, 8.0, 2.0)
    for load_n in before:
        controller.want(sense(load_n=load_n), 8.0, 0.0)
    for _ in range(100):
        controller.want(sense(load_n=0.0, known=False), 8.0, 0.0)
    after = [{"p_safe": 0.9, "load_n": n} for n in before[:100]]
    assert set(answers_of(controller, *after, given_n=8.0)) == {8.0}


def test_holdfast_that_cannot_revoke_keeps_its_grip_in_a_hand_over() -> None:
    controller = after_a_hold("holdfast", 8.0, AnswerRules(revocable=False))
    taken = [{"p_safe": 0.9, "load_n": n} for n in ramp(0.0, 0.3)]
    assert answers_of(controller, *taken, given_n=8.0)[-1] == 8.0


def test_holdfast_raises_to_what_friction_needs_only_where_it_has_answered() -> None:
    for margin, expected in ((True, 9.0), (False, 7.0)):
        controller = after_a_hold("holdfast", 8.0, AnswerRules(margin=margin))
        assert controller.want(sense(), 7.0, 9.0) == expected
        assert controller.want(sense(), 0.0, 9.0) == 0.0


def test_an_unknown_controller_is_refused_with_the_names_there_are() -> None:
    with pytest.raises(
        UsageError, match="pd-shear, sliding-mode, smsp, ismsp, holdfast"
    ):
        controller_of("pid", ONE_HAND, RATE_HZ)


# a whole stream, number by number

TARGETS_N = {
    "none": (0.000000, "0 0 0 0 0 0 0 0 0 0 0"),
    "pd-shear": (
        3710.248639,
        "2.621227 3.723321 4.459152 4.562934 4.231004 8.807789"
        " 5.706427 6.874497 5.792566 5.793464 5.53853",
    ),
    "sliding-mode": (
        1345.986860,
        "0 2.141056 0.682662 2.026205 2.168779 1.911353"
        " 2.053928 2.196502 1.939076 2.08165 2.224225",
    ),
    "smsp": (
        5245.770679,
        "0 0 11.197138 11.197138 8.930471 4.263805 3.609087 11.609087 11.609087 0 0",
    ),
    "ismsp": (34311.039732, "0 0 61.863805 70 70 69.2 64.533333 70 70 0 0"),
    "holdfast": (
        5229.616897,
        "0 0 26.482178 3.975243 3.975243 0 0 15.030068 3.884223 0 0",
    ),
}
"""Sum of all targets of the scripted senses, and every 70th from the 130th on, N a side."""


@pytest.mark.parametrize("name", TARGETS_N)
def test_each_controller_answers_a_whole_stream_by_its_formulas(name: str) -> None:
    controller = controller_of(name, ONE_HAND, RATE_HZ)
    loop = GripLoop(ONE_HAND, RATE_HZ, controller, shear_gain=1.1)
    targets_n = [loop.step(one) for one in scripted_senses()]
    total_n, each_n = TARGETS_N[name]
    assert sum(targets_n) == pytest.approx(total_n, abs=1e-4)
    each = [float(one) for one in each_n.split()]
    assert targets_n[130::70] == pytest.approx(each, abs=1e-5)


@pytest.mark.parametrize(
    ("rules", "total_n"),
    [
        (AnswerRules(graded=False), 4634.168316729319),
        (AnswerRules(revocable=False, margin=False), 3776.891210794735),
        (AnswerRules(rise_n=2.0, yield_samples=5), 4307.504804435801),
    ],
)
def test_the_rules_of_an_answer_and_the_limits_of_a_hand_change_a_whole_stream(
    rules: AnswerRules, total_n: float
) -> None:
    limits = Limits(20.0, most_rise_s=0.1, give_back_s=0.2, give_back_n_s=5.0)
    controller = controller_of("holdfast", ONE_HAND, RATE_HZ, rules=rules)
    loop = GripLoop(ONE_HAND, RATE_HZ, controller, limits)
    targets_n = [loop.step(one) for one in scripted_senses()]
    assert sum(targets_n) == pytest.approx(total_n, abs=1e-5)


def test_the_friction_margin_and_the_swing_follow_a_whole_stream() -> None:
    margin = FrictionMargin(ONE_HAND, RATE_HZ, 1.1)
    swing = LoadSwing(ONE_HAND, RATE_HZ)
    rows, falls = [], []
    for one in scripted_senses():
        margin.step(one)
        falls.append(swing.step(one.load_n, one.known))
        numbers = (margin.mu_hat, margin.needed_n, margin.holds_n)
        rows.append([*numbers, margin.margin, margin.held])
    assert np.sum(rows, axis=0).tolist() == pytest.approx(
        [384.976599, 2364.486645, 3601.042836, 31.687184, 445.255685], abs=1e-5
    )
    assert rows[250] == pytest.approx(
        [0.589305, 3.618923, 3.618923, 0.279248, 0.589305], abs=1e-6
    )
    assert [k for k, fell in enumerate(falls) if fell] == [*range(441, 480)]


@pytest.mark.parametrize("name", ["grip_n", "load_n", "p_risky", "p_safe"])
def test_a_sample_with_a_number_that_is_none_is_unknown(name: str) -> None:
    assert not possible(ONE_HAND, sense(**{name: float("nan")})).known
    many = possible(ManyHands(2), sense(**{name: np.array([np.nan, 0.5])}))
    assert many.known.tolist() == [False, True]
    beyond = sense(grip_n=2e9, load_n=-1.0, p_risky=1.5, p_safe=-0.1)
    one = possible(ONE_HAND, beyond)
    assert (one.grip_n, one.load_n, one.p_risky, one.p_safe) == (1e9, 0.0, 1.0, 0.0)
    assert one.known
