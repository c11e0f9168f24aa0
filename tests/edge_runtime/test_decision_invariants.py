"""Every state that the decision can reach, and every input in each of them: what can never happen,
does not.

docs/safety.md has the same invariants as a table.
"""

from __future__ import annotations

from collections.abc import Iterator
from itertools import product
from typing import NamedTuple

import pytest
from hazard_marks import INVARIANTS
from msgspec.structs import replace

from holdfast.core.contract import GRASP, NOTHING, RISKY_SLIP, SAFE_SLIP
from holdfast.edge_runtime.decision import UNKNOWN, DecisionRules, DecisionState, decide

PERIOD_US = 1000
RULES = [
    DecisionRules(arm, act, release, 500, override_ms=override, evidence_ms=evidence)
    for arm, act, release, override, evidence in product(
        (1, 3), (1, 2, 3), (1, 3), (1, 4), (1, 3)
    )
]


class Input(NamedTuple):
    """What one sample brings; sure: as many votes as the rules want."""

    situation: int
    sure: bool
    opening: bool
    override: bool


INPUTS = [
    Input(*one)
    for one in product(
        (UNKNOWN, NOTHING, GRASP, SAFE_SLIP, RISKY_SLIP),
        (False, True),
        (False, True),
        (False, True),
    )
]


class Step(NamedTuple):
    """From one reachable state by one input to the next."""

    rules: DecisionRules
    before: DecisionState
    given: Input
    after: DecisionState


def stepped(rules: DecisionRules, state: DecisionState, given: Input) -> DecisionState:
    permille = 500 if given.sure else 499
    return decide(
        rules,
        state,
        given.situation,
        permille,
        period_us=PERIOD_US,
        opening=given.opening,
        override=given.override,
    )


def search(rules: DecisionRules) -> Iterator[Step]:
    """Every step from every state that can be reached from the first."""
    seen, ahead = {DecisionState()}, [DecisionState()]
    while ahead:
        before = ahead.pop()
        for given in INPUTS:
            after = stepped(rules, before, given)
            yield Step(rules, before, given, after)
            if after not in seen:
                seen.add(after)
                ahead.append(after)


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    return [step for rules in RULES for step in search(rules)]


@INVARIANTS.mark
def test_the_search_ends_and_is_of_some_size(
    steps: list[Step], record_property
) -> None:
    record_property("steps searched", len(steps))
    assert 50_000 < len(steps) < 10_000_000


@INVARIANTS.mark
def test_no_act_without_arm(steps: list[Step]) -> None:
    assert all(step.after.arm for step in steps if step.after.act)


@INVARIANTS.mark
def test_no_arm_and_no_act_while_an_override_lasts(steps: list[Step]) -> None:
    for step in steps:
        if step.given.override:
            assert step.after.override_us == 1000 * step.rules.override_ms
            assert step.after.risky_run == 0
        if step.after.overridden:
            assert not step.after.arm
            assert not step.after.act


@INVARIANTS.mark
def test_no_act_while_the_user_opens_the_hand(steps: list[Step]) -> None:
    assert not any(step.after.act for step in steps if step.given.opening)


@INVARIANTS.mark
def test_an_act_begins_only_with_a_full_run_of_counted_risky_samples(
    steps: list[Step],
) -> None:
    begun = [step for step in steps if step.after.act and not step.before.act]
    assert begun
    for step in begun:
        assert step.given.situation == RISKY_SLIP
        assert step.given.sure
        assert step.before.risky_run + 1 >= step.rules.act_samples


@INVARIANTS.mark
def test_a_run_grows_by_counted_risky_samples_only_and_every_other_known_sample_ends_it(
    steps: list[Step],
) -> None:
    for step in steps:
        counted = step.given.situation == RISKY_SLIP and step.given.sure
        if step.after.risky_run > step.before.risky_run:
            assert counted
        if step.given.situation != UNKNOWN and not counted:
            assert step.after.risky_run == 0


@INVARIANTS.mark
def test_an_unknown_sample_begins_no_act_and_ends_none(steps: list[Step]) -> None:
    """It changes nothing at all but the time that an override has left."""
    for step in steps:
        unknown, _, opening, override = step.given
        if unknown == UNKNOWN and not opening and not override:
            left_us = step.after.override_us
            assert step.after == replace(step.before, override_us=left_us)


@INVARIANTS.mark
def test_an_act_without_evidence_lasts_a_bounded_time(steps: list[Step]) -> None:
    """Every known sample without evidence brings its end closer, and there is always an end
    ahead."""
    for step in steps:
        if step.before.act and step.after.act and step.given.situation != UNKNOWN:
            fresh = step.given.situation == RISKY_SLIP and step.given.sure
            assert (
                fresh or step.after.evidence_us == step.before.evidence_us - PERIOD_US
            )
            assert 0 < step.after.evidence_us <= 1000 * step.rules.evidence_ms


@INVARIANTS.mark
def test_an_override_ends_by_its_time_or_by_an_empty_hand(steps: list[Step]) -> None:
    for step in steps:
        if step.before.overridden and not step.after.overridden:
            empty = step.after.nothing_run >= step.rules.release_samples
            assert empty or step.before.override_us <= PERIOD_US
        elif step.after.overridden and not step.given.override:
            assert step.after.override_us == step.before.override_us - PERIOD_US


@INVARIANTS.mark
def test_an_act_that_ends_says_how_and_it_is_true(steps: list[Step]) -> None:
    ended = [step for step in steps if step.before.act and not step.after.act]
    assert {step.after.ended for step in ended} == {
        "released",
        "timed_out",
        "opened",
        "overridden",
    }
    for step in ended:
        how = step.after.ended
        assert (how == "overridden") == step.given.override
        assert how != "opened" or step.given.opening
        assert how != "released" or step.after.nothing_run >= step.rules.release_samples
        assert how != "timed_out" or step.before.evidence_us <= PERIOD_US


@INVARIANTS.mark
def test_while_an_act_lasts_no_answer_reports_an_end(steps: list[Step]) -> None:
    assert all(step.after.ended is None for step in steps if step.after.act)
