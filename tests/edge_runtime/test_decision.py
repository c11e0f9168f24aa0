"""The decision: integers in, one request out; it tightens early, lets go late, and never on a
guess."""

from __future__ import annotations

from dataclasses import replace
from typing import NamedTuple

import pytest
from hazard_marks import NO_EVIDENCE, OPENING, OVERRIDE
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP
from holdfast.edge_runtime.decision import (
    LIMITS,
    UNKNOWN,
    DecisionRules,
    DecisionState,
    decide,
    period_us,
)
from holdfast.edge_runtime.grip import AnswerRules

LABELS = (UNKNOWN, NOTHING, GRASP, SAFE_SLIP, RISKY_SLIP)
RULES = DecisionRules()
PERIOD_US = period_us(150.0)
EVIDENCE = RULES.evidence_ms * 150 // 1000
"""Samples for which an act goes on without a risky label."""


class Given(NamedTuple):
    """The inputs of the decision at one sample."""

    situation: int
    permille: int = 1000
    opening: bool = False
    override: bool = False


def fed(
    inputs: list[Given], rules: DecisionRules = RULES, period_us: int = PERIOD_US
) -> list[DecisionState]:
    """The state after every sample."""
    state = DecisionState()
    states = []
    for now in inputs:
        state = decide(
            rules,
            state,
            now.situation,
            now.permille,
            period_us=period_us,
            opening=now.opening,
            override=now.override,
        )
        states.append(state)
    return states


def after(inputs: list[Given], rules: DecisionRules = RULES) -> DecisionState:
    return fed(inputs, rules)[-1]


def times(count: int, situation: int, permille: int = 1000) -> list[Given]:
    return [Given(situation, permille)] * count


any_inputs = st.lists(
    st.builds(
        Given,
        st.sampled_from(LABELS),
        st.integers(0, 1000),
        st.booleans(),
        st.integers(0, 9).map(lambda n: n == 0),
    ),
    min_size=1,
    max_size=40,
)
milliseconds = st.integers(1, 200)
any_rules = st.builds(
    DecisionRules,
    st.integers(1, 4),
    st.integers(1, 6),
    st.integers(1, 6),
    st.integers(0, 1000),
    milliseconds,
    milliseconds,
)


@given(rules=any_rules)
@settings(max_examples=50)
def test_it_arms_and_acts_after_as_many_risky_samples_in_a_row_as_the_rules_say(
    rules: DecisionRules,
) -> None:
    states = fed(times(12, RISKY_SLIP), rules)
    assert [s.act for s in states].index(True) == rules.act_samples - 1
    assert [s.arm for s in states].index(True) == min(
        rules.arm_samples, rules.act_samples
    ) - 1


@NO_EVIDENCE.mark
@pytest.mark.parametrize("later", [GRASP, SAFE_SLIP])
def test_an_act_without_fresh_evidence_times_out_and_says_so(later: int) -> None:
    states = fed(times(2, RISKY_SLIP) + times(EVIDENCE + 1, later))
    assert all(state.act for state in states[1:EVIDENCE])
    ended = states[-1]
    assert (ended.arm, ended.act, ended.ended) == (False, False, "timed_out")


def test_it_releases_when_there_has_been_nothing_for_long_enough_and_not_a_sample_sooner() -> (
    None
):
    acting = times(2, RISKY_SLIP)
    short, enough = (
        times(RULES.release_samples - 1, NOTHING),
        times(RULES.release_samples, NOTHING),
    )
    assert after(acting + short).act
    assert after(acting + short + times(1, GRASP) + short).act
    assert not after(acting + enough).act
    assert not after(acting + enough).arm


@OVERRIDE.mark
def test_an_override_lasts_for_two_seconds_after_its_last_sample_whatever_is_seen() -> (
    None
):
    override = [*times(2, RISKY_SLIP), Given(RISKY_SLIP, override=True)]
    two_seconds = -(-1000 * RULES.override_ms // PERIOD_US)
    assert not any(
        state.arm for state in fed(override + times(two_seconds, RISKY_SLIP))[2:]
    )
    assert after(override).ended == "overridden"
    assert after(override + times(two_seconds + 2, RISKY_SLIP)).act
    renewed = (
        override
        + times(200, RISKY_SLIP)
        + [Given(RISKY_SLIP, override=True)]
        + times(two_seconds, RISKY_SLIP)
    )
    assert not any(state.arm for state in fed(renewed)[2:])


@OPENING.mark
def test_opening_the_hand_ends_a_running_act_and_prevents_a_new_one() -> None:
    opening = [Given(RISKY_SLIP, opening=True)]
    assert not any(s.act for s in fed(opening * 10))
    assert after(opening * 10).arm
    opened = after(times(2, RISKY_SLIP) + opening)
    assert (opened.act, opened.ended) == (False, "opened")
    assert after(opening * 10 + times(1, RISKY_SLIP)).act


@given(inputs=any_inputs, rules=any_rules, factor=st.integers(2, 50))
@settings(max_examples=50)
def test_times_are_of_the_clock_and_not_of_samples(
    inputs: list[Given], rules: DecisionRules, factor: int
) -> None:
    """With every time and the period made longer alike, the same is requested."""
    longer = replace(
        rules,
        override_ms=factor * rules.override_ms,
        evidence_ms=factor * rules.evidence_ms,
    )
    states = fed(inputs * 3, rules)
    stretched = fed(inputs * 3, longer, factor * PERIOD_US)
    for a, b in zip(states, stretched, strict=True):
        assert (a.arm, a.act, a.ended) == (b.arm, b.act, b.ended)


@pytest.mark.parametrize("name", LIMITS)
def test_a_rule_outside_its_limits_is_refused(name: str) -> None:
    least, most = LIMITS[name]
    widest = replace(RULES, answer_permille=1, full_answer_permille=999)
    for good in (least, most):
        replace(widest, **{name: good})
    for bad in (least - 1, most + 1, 1.5, True, "2"):
        with pytest.raises(ValueError, match=name):
            DecisionRules(**{name: bad})  # type: ignore[arg-type]


def test_a_full_answer_is_above_the_least_one() -> None:
    with pytest.raises(ValueError, match="full answer"):
        DecisionRules(answer_permille=850)


def test_what_the_grip_goes_by_stands_in_a_card_only_where_it_differs() -> None:
    usual = DecisionRules()
    assert not {"follow_floor_permille", "safe_follow_mn"} & set(usual.to_json())
    rules = replace(
        usual,
        follow_floor_permille=130,
        follow_above_permille=1400,
        safe_follow_mn=2500,
    )
    card = rules.to_json()
    assert DecisionRules(**card) == rules
    answer = AnswerRules.of(rules)
    assert (answer.floor, answer.above, answer.safe_follow_n) == (0.13, 1.4, 2.5)
    assert AnswerRules.of(usual) == AnswerRules()
