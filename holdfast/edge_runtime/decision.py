"""From one label a sample to one request: a pure integer state machine, no floats, no clock.

arm: `arm_samples` risky samples in a row. act: `act_samples` in a row; the hand should tighten. A
risky label with less than `min_risky_permille` of the votes does not count (rejection by
confidence).

An act continues when the alarm ends, because evidence comes and goes within a slip. An act ends

- "released": the situation is "nothing" for `release_samples` in a row;
- "timed_out": no risky label for `evidence_ms` of known samples;
- "opened": the wearer opens the hand, which also prevents a new act;
- "overridden": the wearer overrides. The override lasts until the hand has been empty (as above) or
  for `override_ms` after its last sample; meanwhile nothing arms and nothing is counted.

While the state is unknown, nothing is counted and nothing is released. docs/safety.md has the
invariants as a table; tests/edge_runtime/test_decision_invariants.py searches every reachable
state.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass
from typing import Literal

import msgspec
from msgspec.structs import replace

from holdfast.core.contract import NOTHING, RISKY_SLIP

UNKNOWN = -1
ActEnd = Literal["released", "timed_out", "opened", "overridden"]

LIMITS = {
    "arm_samples": (1, 10_000),
    "act_samples": (1, 10_000),
    "release_samples": (1, 10_000),
    "min_risky_permille": (0, 1000),
    "override_ms": (1, 600_000),
    "evidence_ms": (1, 600_000),
    "answer_permille": (1, 998),
    "full_answer_permille": (2, 999),
    "follow_floor_permille": (1, 1000),
    "follow_above_permille": (1001, 10_000),
    "safe_follow_mn": (0, 1_000_000),
}
"""Least and largest value of every parameter."""
OF_THE_GRIP = (
    "answer_permille",
    "full_answer_permille",
    "follow_floor_permille",
    "follow_above_permille",
    "safe_follow_mn",
)
"""Parameters that the grip controller goes by."""


def period_us(rate_hz: float) -> int:
    """The period of a rate, in whole us."""
    return round(1e6 / rate_hz)


@dataclass(frozen=True)
class DecisionRules:
    """Parameters in samples, thousandths and ms, stored in the model's metadata.

    The docstring of the module explains all but the last five, which the grip controller goes by
    (AnswerRules: from_p, full_p, floor, above, safe_follow_n): they belong to the model, because
    learners differ in what they mean by a probability. Raises ValueError for one outside LIMITS.
    """

    arm_samples: int = 1
    act_samples: int = 2
    release_samples: int = 5
    min_risky_permille: int = 0
    override_ms: int = 2000
    evidence_ms: int = 2000
    answer_permille: int = 700
    full_answer_permille: int = 850
    follow_floor_permille: int = 200
    follow_above_permille: int = 1150
    safe_follow_mn: int = 0

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            least, most = LIMITS[name]
            # not isinstance: True is an int
            if type(value) is not int or not least <= value <= most:
                raise ValueError(
                    f"{name} = {value!r:.40}, not a whole number from {least} to {most}"
                )
        if self.answer_permille >= self.full_answer_permille:
            raise ValueError("a full answer is not above answer_permille")

    def to_json(self) -> dict[str, int]:
        """As a JSON object of integers."""
        fields = asdict(self)
        # The card of a usual grip is as it was before there was a choice.
        for name in OF_THE_GRIP:
            if fields[name] == getattr(DecisionRules, name):
                del fields[name]
        return fields


# a Struct: copies of it are made at every sample, with the caches of a small board cold
class DecisionState(msgspec.Struct, frozen=True):
    """Risky samples in a row, empty samples in a row, the request, and the time left.

    override_us, evidence_us: until the override, and the act, end by themselves. ended: how the
    last act ended.
    """

    risky_run: int = 0
    nothing_run: int = 0
    arm: bool = False
    act: bool = False
    override_us: int = 0
    evidence_us: int = 0
    ended: ActEnd | None = None

    @property
    def overridden(self) -> bool:
        """Whether the wearer's override lasts."""
        return self.override_us > 0


def decide(
    rules: DecisionRules,
    state: DecisionState,
    situation: int,
    risky_permille: int,
    *,
    period_us: int,
    opening: bool = False,
    override: bool = False,
) -> DecisionState:
    """The state after one sample's label (UNKNOWN, or 0..3) and the risky share of its votes.

    period_us: time from one sample to the next. opening, override: what the wearer commands at this
    sample.
    """
    # first of all, in every state: the wearer's command wins
    if override:
        ended = "overridden" if state.act else state.ended
        return DecisionState(override_us=1000 * rules.override_ms, ended=ended)
    if state.overridden:
        return _overridden(rules, state, situation, period_us)
    if situation == UNKNOWN:
        # never a release on a guess; only the wearer ends an act then
        return _ended(rules, state, "opened") if opening and state.act else state

    risky = situation == RISKY_SLIP and risky_permille >= rules.min_risky_permille
    counted = _counted(rules, state, situation, risky, period_us)
    return _known(rules, counted, opening)


def _counted(
    rules: DecisionRules,
    state: DecisionState,
    situation: int,
    risky: bool,
    period_us: int,
) -> DecisionState:
    """The runs and the time left after one known sample; the request is unchanged."""
    risky_run = 0
    evidence_us = max(0, state.evidence_us - period_us)
    if risky:
        # bounded, so that all states can be searched; no rule needs a longer run
        risky_run = min(state.risky_run + 1, rules.act_samples + rules.arm_samples)
        evidence_us = 1000 * rules.evidence_ms

    return replace(
        state,
        risky_run=risky_run,
        nothing_run=_nothing_run(rules, state, situation),
        evidence_us=evidence_us,
    )


def _known(rules: DecisionRules, state: DecisionState, opening: bool) -> DecisionState:
    """The request, after a known sample has been counted."""
    if opening:
        return _ended(rules, state, "opened") if state.act else _armed(rules, state)
    if state.risky_run >= rules.act_samples:
        return replace(state, arm=True, act=True, ended=None)
    if not state.act:
        return _armed(rules, state)
    if state.nothing_run >= rules.release_samples:
        return _ended(rules, state, "released")

    return state if state.evidence_us else _ended(rules, state, "timed_out")


def _armed(rules: DecisionRules, state: DecisionState) -> DecisionState:
    """`arm` follows the run of risky samples."""
    return replace(state, arm=state.risky_run >= rules.arm_samples)


def _ended(rules: DecisionRules, state: DecisionState, how: ActEnd) -> DecisionState:
    """The act is over; the next one needs a full run again."""
    return _armed(rules, replace(state, act=False, ended=how))


def _overridden(
    rules: DecisionRules, state: DecisionState, situation: int, period_us: int
) -> DecisionState:
    """One sample of an override that lasts: only its own end is counted."""
    left_us = max(0, state.override_us - period_us)
    nothing_run = state.nothing_run
    if situation != UNKNOWN:
        nothing_run = _nothing_run(rules, state, situation)
    # an empty hand ends an override early: there is nothing to be let go any more
    if nothing_run >= rules.release_samples:
        left_us = 0
    return replace(state, nothing_run=nothing_run, override_us=left_us)


def _nothing_run(rules: DecisionRules, state: DecisionState, situation: int) -> int:
    """Empty samples in a row, counted up to what the rule needs."""
    if situation != NOTHING:
        return 0
    return min(state.nothing_run + 1, rules.release_samples)
