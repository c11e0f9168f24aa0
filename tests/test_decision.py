"""The decision: integers in, one request out; it tightens early, lets go late, and never on a guess."""

from __future__ import annotations

from dataclasses import asdict
from functools import reduce
from typing import NamedTuple

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from edge_runtime.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP
from edge_runtime.decision import UNKNOWN, DecisionRules, DecisionState, decide

LABELS = (UNKNOWN, NOTHING, GRASP, SAFE_SLIP, RISKY_SLIP)
RULES = DecisionRules()


class Told(NamedTuple):
    """What the machine is told at one sample."""

    situation: int
    permille: int = 1000
    opening: bool = False
    override: bool = False


def fed(told: list[Told], rules: DecisionRules = RULES, start: DecisionState | None = None) -> list[DecisionState]:
    """The state after every sample."""
    states = [start or DecisionState()]
    for now in told:
        states.append(
            decide(rules, states[-1], now.situation, now.permille, opening=now.opening, override=now.override)
        )
    return states[1:]


def after(told: list[Told], rules: DecisionRules = RULES) -> DecisionState:
    return fed(told, rules)[-1]


def times(count: int, situation: int, permille: int = 1000) -> list[Told]:
    return [Told(situation, permille)] * count


told_anything = st.lists(
    st.builds(
        Told, st.sampled_from(LABELS), st.integers(0, 1000), st.booleans(), st.integers(0, 9).map(lambda n: n == 0)
    ),
    min_size=1,
    max_size=40,
)
any_rules = st.builds(DecisionRules, st.integers(1, 4), st.integers(1, 6), st.integers(1, 6), st.integers(0, 1000))


def test_it_arms_at_the_first_risky_sample_and_acts_at_the_second() -> None:
    states = fed(times(3, RISKY_SLIP))
    assert [(s.arm, s.act) for s in states] == [(True, False), (True, True), (True, True)]


@given(rules=any_rules)
@settings(max_examples=50)
def test_it_arms_and_acts_after_as_many_risky_samples_in_a_row_as_the_rules_say(rules: DecisionRules) -> None:
    states = fed(times(12, RISKY_SLIP), rules)
    assert [s.act for s in states].index(True) == rules.act_samples - 1
    assert [s.arm for s in states].index(True) == min(rules.arm_samples, rules.act_samples) - 1


@pytest.mark.parametrize("between", [NOTHING, GRASP, SAFE_SLIP])
def test_one_other_label_starts_the_count_again(between: int) -> None:
    assert not any(s.act for s in fed([Told(RISKY_SLIP), Told(between)] * 5))
    assert not fed([Told(RISKY_SLIP), Told(between)])[-1].arm


@pytest.mark.parametrize("later", [GRASP, SAFE_SLIP, RISKY_SLIP])
def test_once_acting_it_holds_when_the_alarm_ends(later: int) -> None:
    assert after(times(2, RISKY_SLIP) + times(500, later)).act


def test_it_releases_when_there_has_been_nothing_for_long_enough_and_not_a_sample_sooner() -> None:
    acting = times(2, RISKY_SLIP)
    short, enough = times(RULES.release_samples - 1, NOTHING), times(RULES.release_samples, NOTHING)
    assert after(acting + short).act
    assert after(acting + short + times(1, GRASP) + short).act
    assert not after(acting + enough).act
    assert not after(acting + enough).arm


def test_after_a_release_the_next_risky_slip_counts_from_one() -> None:
    released = times(2, RISKY_SLIP) + times(RULES.release_samples, NOTHING)
    assert not after(released + times(1, RISKY_SLIP)).act
    assert after(released + times(2, RISKY_SLIP)).act


@given(told=told_anything, rules=any_rules, gap=st.integers(1, 20), opening=st.booleans())
@settings(max_examples=50)
def test_while_unknown_nothing_is_counted_and_nothing_is_released(
    told: list[Told], rules: DecisionRules, gap: int, opening: bool
) -> None:
    before = after(told, rules)
    assert after(told + [Told(UNKNOWN, opening=opening)] * gap, rules) == before


@given(told=told_anything, rules=any_rules)
@settings(max_examples=50)
def test_unknown_samples_might_as_well_not_have_been(told: list[Told], rules: DecisionRules) -> None:
    known = [now for now in told if now.situation != UNKNOWN or now.override]
    assert after([Told(GRASP), *told], rules) == after([Told(GRASP), *known], rules)


@given(told=told_anything, rules=any_rules, last=st.builds(Told, st.sampled_from(LABELS), opening=st.booleans()))
@settings(max_examples=50)
def test_the_users_override_always_wins_and_ends_what_runs(told: list[Told], rules: DecisionRules, last: Told) -> None:
    assert after([*told, last._replace(override=True)], rules) == DecisionState()


def test_the_hands_own_opening_vetoes_a_new_action_and_does_not_end_a_running_one() -> None:
    opening = [Told(RISKY_SLIP, opening=True)]
    assert not any(s.act for s in fed(opening * 10))
    assert after(opening * 10).arm
    assert after(opening * 10 + times(1, RISKY_SLIP)).act
    assert after(times(2, RISKY_SLIP) + opening * 10).act


@given(rules=any_rules, permille=st.integers(0, 1000))
@settings(max_examples=50)
def test_a_risky_label_with_too_few_votes_does_not_count(rules: DecisionRules, permille: int) -> None:
    convinced = permille >= rules.min_risky_permille
    state = after(times(10, RISKY_SLIP, permille=permille), rules)
    assert (state.arm, state.act) == (convinced, convinced)


def test_a_doubtful_risky_label_ends_a_run_of_risky_ones_and_a_run_of_nothing() -> None:
    strict = DecisionRules(act_samples=3, min_risky_permille=600)
    doubtful = times(1, RISKY_SLIP, permille=599)
    assert not after(times(2, RISKY_SLIP) + doubtful + times(2, RISKY_SLIP), strict).act
    acting = times(3, RISKY_SLIP)
    assert after(acting + times(4, NOTHING) + doubtful + times(4, NOTHING), strict).act


@given(told=told_anything, rules=any_rules, cut=st.integers(0, 40))
@settings(max_examples=50)
def test_it_is_pure_the_same_words_from_the_same_state_give_the_same_state(
    told: list[Told], rules: DecisionRules, cut: int
) -> None:
    whole = fed(told, rules)
    assert fed(told, rules) == whole
    cut = min(cut, len(told))
    resumed = fed(told[cut:], rules, start=whole[cut - 1] if cut else None)
    assert resumed == whole[cut:]


@given(told=told_anything, rules=any_rules)
@settings(max_examples=50)
def test_the_state_stays_small_integers_and_whoever_acts_is_armed(told: list[Told], rules: DecisionRules) -> None:
    for state in fed(told * 3, rules):
        assert all(type(value) in (int, bool) for value in asdict(state).values())
        assert 0 <= state.risky_run <= rules.act_samples + rules.arm_samples
        assert 0 <= state.nothing_run <= rules.release_samples
        assert state.arm or not state.act


@given(told=told_anything, rules=any_rules)
@settings(max_examples=50)
def test_an_action_begins_only_after_a_full_run_and_ends_only_by_nothing_or_override(
    told: list[Told], rules: DecisionRules
) -> None:
    """The rules said a second time, over the whole past at every sample."""
    states = fed(told, rules)
    for k, (was, now) in enumerate(zip([DecisionState(), *states], states, strict=False)):
        past = reduce(lambda kept, t: [] if t.override else [*kept, t], told[: k + 1], list[Told]())
        known = [t for t in past if t.situation != UNKNOWN]
        risky = [t.situation == RISKY_SLIP and t.permille >= rules.min_risky_permille for t in known]
        if now.act and not was.act:
            assert len(risky) >= rules.act_samples
            assert all(risky[-rules.act_samples :])
            assert not told[k].opening
        if was.act and not now.act and not told[k].override:
            assert [t.situation for t in known[-rules.release_samples :]] == [NOTHING] * rules.release_samples


def test_the_rules_are_integers_by_their_names() -> None:
    assert RULES.to_json() == {"arm_samples": 1, "act_samples": 2, "release_samples": 5, "min_risky_permille": 0}
    assert DecisionRules(**RULES.to_json()) == RULES
