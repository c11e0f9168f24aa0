"""Every state that the supervisor of the grip can reach, and every input in each of them.

docs/safety.md has the same invariants as a table.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from dataclasses import fields, replace
from itertools import product
from typing import NamedTuple

import pytest
from grip_senses import QUICK, RATE_HZ, loop_of, numbers_of, sense
from hazard_marks import IMPOSSIBLE_SENSE, SUPERVISOR_INVARIANTS
from hypothesis import given
from hypothesis import strategies as st

from holdfast.edge_runtime.batch import ONE_HAND
from holdfast.edge_runtime.grip import CONTROLLERS, Controller, GripSense, Want
from holdfast.edge_runtime.supervisor import (
    HOLD,
    IDLE,
    RELAX,
    TIGHTEN,
    YIELD,
    Limits,
    Supervisor,
)

PERIOD_S = 0.25
RISE, MOST_RISE, GIVE_BACK = 2, 3, 4
"""Times in samples."""
CEILING_N = 3.0
MANY_STATES = 2000
LIMITS = Limits(
    ceiling_n=CEILING_N,
    rise_s=RISE * PERIOD_S,
    most_rise_s=MOST_RISE * PERIOD_S,
    give_back_s=GIVE_BACK * PERIOD_S,
    give_back_n_s=1.0 / PERIOD_S,
)


class Wish(NamedTuple):
    """What a controller wants at one sample, and what the hand senses."""

    wanted_n: float
    fresh: bool
    holds_n: float
    known: bool = True
    empty: bool = False
    opening: bool = False
    overridden: bool = False

    def to(self, one: Supervisor) -> float:
        """The target that a supervisor makes of it."""
        flags = {name: getattr(self, name) for name in self._fields[3:]}
        want = Want(self.wanted_n, self.fresh, self.holds_n)
        target_n: float = one.step(sense(**flags), want)
        return target_n


FLAGS = (False, True)
INPUTS = [
    Wish(wanted_n, fresh, holds_n, *flags)
    for wanted_n in (0.0, 1.0, 2.5, 3.0, 9.0)
    for fresh in FLAGS
    for holds_n in (0.0, 0.25, 2.0)
    for flags in product(FLAGS, repeat=4)
]
"""Every wanted grip, freshness, grip that holds, known, empty, opening, overridden."""


class State(NamedTuple):
    """What the supervisor remembers: target, N; times in samples."""

    given_n: float
    since: float
    risen: float


class Step(NamedTuple):
    """From one reachable state by one input to the next."""

    before: State
    wish: Wish
    after: State
    mode: int

    @property
    def ends(self) -> bool:
        """The wearer takes over, or the hand is empty."""
        wish = self.wish
        return wish.opening or wish.overridden or (wish.known and wish.empty)

    @property
    def goes_on(self) -> bool:
        """The state is known, and nothing ends the target."""
        return self.wish.known and not self.ends


def state_of(one: Supervisor) -> State:
    return State(one.given_n, one.since_s / PERIOD_S, one.risen_s / PERIOD_S)


def supervisor_in(state: State) -> Supervisor:
    one = Supervisor(ONE_HAND, 1.0 / PERIOD_S, LIMITS)
    one.given_n, one.since_s, one.risen_s = (
        state.given_n,
        state.since * PERIOD_S,
        state.risen * PERIOD_S,
    )
    return one


def stepped(before: State, wish: Wish) -> Step:
    one = supervisor_in(before)
    target_n = wish.to(one)
    assert target_n == one.given_n
    return Step(before, wish, state_of(one), int(one.mode))


def search(first: State) -> Iterator[Step]:
    """Every step from every state that can be reached."""
    seen, ahead = {first}, [first]
    while ahead and len(seen) < MANY_STATES:
        before = ahead.pop()
        for wish in INPUTS:
            step = stepped(before, wish)
            yield step
            if step.after not in seen:
                seen.add(step.after)
                ahead.append(step.after)


@pytest.fixture(scope="module")
def steps() -> list[Step]:
    return list(search(state_of(Supervisor(ONE_HAND, 1.0 / PERIOD_S, LIMITS))))


@SUPERVISOR_INVARIANTS.mark
def test_the_search_of_the_supervisor_ends_and_is_of_some_size(
    steps: list[Step], record_property
) -> None:
    record_property("steps searched", len(steps))
    assert 10_000 < len(steps) < MANY_STATES * len(INPUTS)
    assert {step.mode for step in steps} == {IDLE, HOLD, TIGHTEN, RELAX, YIELD}


@SUPERVISOR_INVARIANTS.mark
def test_an_override_or_an_opening_ends_every_target_at_once(steps: list[Step]) -> None:
    for step in steps:
        if step.wish.opening or step.wish.overridden:
            assert step.after.given_n == 0.0
            assert step.mode == (YIELD if step.before.given_n > 0.0 else IDLE)


@SUPERVISOR_INVARIANTS.mark
def test_an_empty_hand_ends_every_target(steps: list[Step]) -> None:
    assert not any(
        step.after.given_n for step in steps if step.wish.known and step.wish.empty
    )


@SUPERVISOR_INVARIANTS.mark
def test_an_unknown_state_holds_the_target_and_no_time_passes(
    steps: list[Step],
) -> None:
    for step in steps:
        if not step.wish.known and not step.ends:
            assert step.after == step.before
            assert step.mode == HOLD


@SUPERVISOR_INVARIANTS.mark
def test_no_target_is_above_the_ceiling_or_below_zero(steps: list[Step]) -> None:
    assert all(0.0 <= step.after.given_n <= CEILING_N for step in steps)
    assert any(step.after.given_n == CEILING_N for step in steps)


@SUPERVISOR_INVARIANTS.mark
def test_without_limits_of_its_own_no_hand_is_asked_for_more_than_70_newtons() -> None:
    one = Supervisor(ONE_HAND, 1.0 / PERIOD_S, Limits())
    targets_n = [Wish(1000.0, fresh=True, holds_n=0.0).to(one) for _ in range(40)]
    assert max(targets_n) == 70.0


@SUPERVISOR_INVARIANTS.mark
def test_no_target_rises_above_what_the_controller_wants(steps: list[Step]) -> None:
    for step in steps:
        if step.after.given_n > step.before.given_n:
            assert step.after.given_n == min(step.wish.wanted_n, CEILING_N)


@SUPERVISOR_INVARIANTS.mark
def test_no_target_rises_without_evidence_at_this_sample_or_just_before(
    steps: list[Step],
) -> None:
    for step in steps:
        if step.after.given_n > step.before.given_n:
            assert step.wish.fresh or step.before.since + 1 < RISE
        if step.goes_on and step.wish.fresh:
            assert step.after.since == 0
        elif step.goes_on:
            assert step.after.since == min(step.before.since + 1, GIVE_BACK)


@SUPERVISOR_INVARIANTS.mark
def test_a_target_rises_for_a_bounded_time_until_the_evidence_is_long_over(
    steps: list[Step],
) -> None:
    for step in steps:
        rises = step.after.given_n > step.before.given_n
        assert not rises or step.before.risen < MOST_RISE
        assert step.after.risen <= MOST_RISE
        over = step.after.given_n <= 0.0 or step.after.since == GIVE_BACK
        assert step.after.risen == (0 if over else step.before.risen + rises)


@SUPERVISOR_INVARIANTS.mark
def test_without_evidence_a_target_is_given_back_to_the_grip_that_holds(
    steps: list[Step],
) -> None:
    for step in steps:
        if step.goes_on and step.after.since == GIVE_BACK:
            highest_n = min(step.wish.wanted_n, step.before.given_n)
            floor_n = min(step.wish.holds_n, highest_n)
            assert step.after.given_n == max(highest_n - 1.0, floor_n, 0.0)


@SUPERVISOR_INVARIANTS.mark
def test_a_target_falls_only_where_the_controller_or_the_time_wants_it(
    steps: list[Step],
) -> None:
    for step in steps:
        if step.goes_on and step.after.since < GIVE_BACK:
            assert step.after.given_n >= min(step.wish.wanted_n, step.before.given_n)


@SUPERVISOR_INVARIANTS.mark
def test_the_mode_of_a_grip_says_what_happens_to_the_target(steps: list[Step]) -> None:
    for step in steps:
        before_n, after_n = step.before.given_n, step.after.given_n
        if after_n > before_n:
            expected = TIGHTEN
        elif after_n < before_n:
            expected = RELAX if after_n else YIELD
        elif after_n:
            expected = HOLD
        else:
            # an unknown state holds, even where there is nothing to hold
            expected = IDLE if step.wish.known or step.ends else HOLD
        assert step.mode == expected


def test_an_answer_that_the_wearer_ended_begins_again_with_fresh_evidence() -> None:
    one = supervisor_in(State(3.0, 0, MOST_RISE))
    wish = Wish(3.0, fresh=True, holds_n=0.0)
    assert wish._replace(overridden=True).to(one) == 0.0
    assert wish.to(one) == 3.0


@pytest.mark.parametrize("holds_n", [0.0, -1.0, -math.inf])
def test_a_target_that_is_given_back_ends_at_zero_and_not_below(holds_n: float) -> None:
    one = Supervisor(ONE_HAND, RATE_HZ)
    one.given_n = 0.1
    targets = [one.step(sense(), Want(9.0, False, holds_n)) for _ in range(3)]
    assert targets == [pytest.approx(0.1 - 10.0 / RATE_HZ), 0.0, 0.0]
    assert one.mode == IDLE


ANY = st.floats(allow_nan=True, allow_infinity=True)
ANY_SENSE = st.builds(
    GripSense, ANY, ANY, ANY, ANY, *[st.sampled_from((False, False, True))] * 4
)


@IMPOSSIBLE_SENSE.mark
@pytest.mark.parametrize("kind", CONTROLLERS.values(), ids=CONTROLLERS)
@given(st.lists(ANY_SENSE, max_size=30))
def test_whatever_is_sensed_every_controller_s_target_is_finite_and_within_the_ceiling(
    kind: type[Controller], senses: list[GripSense]
) -> None:
    loop = loop_of(ONE_HAND, kind)
    for _ in range(3):
        loop.step(sense(p_risky=1.0))
    for one in senses:
        before_n = loop.supervisor.given_n
        target_n = loop.step(one)
        assert 0.0 <= target_n <= QUICK.ceiling_n
        assert all(map(math.isfinite, numbers_of(loop)))
        numbers = (one.grip_n, one.load_n, one.p_risky, one.p_safe)
        if one.opening or one.overridden:
            assert target_n == 0.0
        # held, and neither tightened nor released
        elif not one.known or any(map(math.isnan, numbers)):
            assert target_n == before_n


@IMPOSSIBLE_SENSE.mark
@given(st.lists(st.builds(Want, ANY, st.booleans(), ANY), max_size=30))
def test_whatever_is_wanted_a_target_is_finite_and_within_the_ceiling(
    wants: list[Want],
) -> None:
    supervisor = Supervisor(ONE_HAND, RATE_HZ, QUICK)
    for want in wants:
        before_n = supervisor.given_n
        target_n = supervisor.step(sense(), want)
        assert 0.0 <= target_n <= QUICK.ceiling_n
        if math.isnan(want.target_n):
            assert target_n <= before_n


@pytest.mark.parametrize("wrong", [float("nan"), -1.0])
@pytest.mark.parametrize("name", [one.name for one in fields(Limits)])
def test_a_limit_that_is_no_number_from_zero_on_is_refused(
    name: str, wrong: float
) -> None:
    with pytest.raises(ValueError, match=f"{name} = {wrong}"):
        replace(Limits(), **{name: wrong})
