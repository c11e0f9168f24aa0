"""From one label a sample to one request: a pure integer state machine, no floats, no clock.

arm: a risky slip has been seen for `arm_samples` in a row. act: for `act_samples` in a row; the hand
should tighten. Once acting it holds until the load falls (the situation is "nothing" for
`release_samples` in a row): letting go because the alarm ended would drop the object. A risky label
with less than `min_risky_permille` of the votes does not count (rejection by confidence). While the
state is unknown nothing is counted and nothing is released. The hand's own opening command vetoes a
new action; the user's override always wins and ends a running one.
"""

from __future__ import annotations

from dataclasses import asdict, dataclass, replace

from edge_runtime.contract import NOTHING, RISKY_SLIP

UNKNOWN = -1


@dataclass(frozen=True)
class DecisionRules:
    """Parameters in samples and thousandths; they travel in the model's metadata."""

    arm_samples: int = 1
    act_samples: int = 2
    release_samples: int = 5
    min_risky_permille: int = 0

    def to_json(self) -> dict[str, int]:
        """As a JSON object of integers."""
        return asdict(self)


@dataclass(frozen=True)
class DecisionState:
    """Risky samples in a row, samples of no contact in a row, and what is requested now."""

    risky_run: int = 0
    nothing_run: int = 0
    arm: bool = False
    act: bool = False


def decide(
    rules: DecisionRules,
    state: DecisionState,
    situation: int,
    risky_permille: int,
    *,
    opening: bool = False,
    override: bool = False,
) -> DecisionState:
    """Next state after one sample's label (UNKNOWN, or 0..3) and the risky share of the votes."""
    if override:
        return DecisionState()
    if situation == UNKNOWN:
        return state
    risky = situation == RISKY_SLIP and risky_permille >= rules.min_risky_permille
    risky_run = min(state.risky_run + 1, rules.act_samples + rules.arm_samples) if risky else 0
    nothing_run = min(state.nothing_run + 1, rules.release_samples) if situation == NOTHING else 0
    released = nothing_run >= rules.release_samples
    called = risky_run >= rules.act_samples and not opening
    act = called or (state.act and not released)
    return replace(
        state, risky_run=risky_run, nothing_run=nothing_run, arm=act or risky_run >= rules.arm_samples, act=act
    )
