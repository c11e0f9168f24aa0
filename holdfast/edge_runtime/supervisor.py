"""What may reach the hand: the last word on every wanted grip. The wearer always wins.

    the wearer overrides, or opens     yield: every request ends at once
    the state is unknown               hold: neither tighten nor relax, and no time passes
    the hand is empty                  idle
    a larger grip is wanted            tighten, up to the ceiling, while evidence is fresh (rise_s)
                                       and not for longer than most_rise_s an answer
    a smaller grip is wanted           relax
    no evidence for give_back_s        relax slowly to the grip that is known to hold the load
                                       (holdfast/edge_runtime/grip_control.py)
    else                               hold

A controller remembers nothing of what it wanted: it receives what was given.

How long an override lasts is the decision's business (edge_runtime/decision.py); every prediction
carries it as `overridden`. The rules run on one hand or on many (edge_runtime/batch.py).
docs/safety.md has the invariants; tests/edge_runtime/test_supervisor.py searches every state.

One grip command a sample reaches the hand, as one JSON line:

    {"sequence":812,"t_ns":5413333333,"mode":"tighten","target_n":9.4,"slew_n_s":400.0,
     "feedback":0.8,"reason":"risky slip","mu_hat":0.61,"margin":0.12,"expires_ms":300}

target_n is what the hand may add while its wearer does not open it (GripCommand in the contract).
core/hand_lines.py says which lines a receiver obeys. `docs/shared-control.md` has every field, and
a receiver in Python and in C. A hand that has got no line for expires_ms holds its grip.
"""

from __future__ import annotations

import json
from dataclasses import asdict, dataclass
from typing import TYPE_CHECKING

from holdfast.core.contract import GripCommand as GripCommand
from holdfast.core.contract import Mode
from holdfast.core.schema import ranged
from holdfast.edge_runtime.batch import Batch, Flag, Number

if TYPE_CHECKING:
    from holdfast.edge_runtime.grip import GripSense, Want

MODES: tuple[Mode, ...] = ("idle", "hold", "tighten", "relax", "yield")
"""Modes by index, as the supervisor of many hands keeps them in arrays of numbers."""
IDLE, HOLD, TIGHTEN, RELAX, YIELD = range(5)
EXPIRES_MS = 300
"""For so long a command is valid; a hand without a later one holds its grip."""
_to_json = json.JSONEncoder(separators=(",", ":")).encode


def to_line(command: GripCommand) -> str:
    """One JSON line, without a line end."""
    values = command._asdict()
    for name, value in values.items():
        if isinstance(value, float):
            values[name] = round(value, 4)
    values["expires_ms"] = EXPIRES_MS
    return _to_json(values)


def last_line(sequence: int, t_ns: int, reason: str) -> str:
    """The line that ends a run: the hand holds the grip that it has."""
    return to_line(GripCommand(sequence, t_ns, "hold", None, 0.0, 0.0, reason))


@dataclass(frozen=True)
class Limits:
    """What a hand allows. Raises ValueError for one that is no number from 0 on."""

    ceiling_n: float = ranged(70.0, "largest target")
    slew_n_s: float = ranged(400.0, "fastest change, passed on to the drive")
    rise_s: float = ranged(0.2, "a target rises for so long after evidence")
    most_rise_s: float = ranged(2.0, "and for so long in one answer")
    give_back_s: float = ranged(1.0, "so long after evidence a target is given back")
    give_back_n_s: float = ranged(10.0, "at this speed")

    def __post_init__(self) -> None:
        for name, value in asdict(self).items():
            # nan fails the comparison: as a ceiling it would bound nothing by mistake; inf bounds
            # nothing on purpose, on raw fields, which have no newtons
            if not value >= 0.0:
                raise ValueError(f"{name} = {value!r:.40} is no number from 0 on")


class Supervisor:
    """given_n: the target that reaches the hand, N a side, 0 for none. mode: index of MODES."""

    def __init__(
        self, batch: Batch, rate_hz: float, limits: Limits | None = None
    ) -> None:
        self._batch = batch
        self.limits = limits or Limits()
        self._period_s = 1.0 / rate_hz
        self.given_n = batch.zero()
        self.risen_s = batch.zero()
        # as if evidence had ended long ago: nothing may rise before the first
        self.since_s: Number = batch.zero() + self.limits.give_back_s
        self.mode: Number = batch.zero() + HOLD

    def step(self, sense: GripSense, want: Want) -> Number:
        """The target after one sample; sets `mode`."""
        batch = self._batch
        unknown = batch.no(sense.known)
        # an empty hand counts only where it is known to be empty
        ends = sense.opening | sense.overridden | (sense.known & sense.empty)

        self._pass_time(sense.known, want.fresh)
        target_n = self._given_back(self._followed(want.target_n), want.holds_n)

        # In an unknown state the samples are no reason to tighten or to relax, so the target stays.
        target_n = batch.choose(unknown, self.given_n, target_n)

        # last, so that the wearer wins over everything above
        target_n = batch.choose(ends, 0.0, target_n)

        longer_s = self.risen_s + self._period_s
        self.risen_s = batch.choose(target_n > self.given_n, longer_s, self.risen_s)

        # an answer is over when its target has ended, or long after its evidence
        over = (target_n <= 0.0) | (self.since_s >= self.limits.give_back_s)
        self.risen_s = batch.choose(over, 0.0, self.risen_s)

        self.mode = self._mode(target_n, unknown, ends)
        self.given_n = target_n

        return target_n

    def _pass_time(self, known: Flag, fresh: Flag) -> None:
        """Time since the last evidence; it stands still while the state is unknown."""
        batch = self._batch
        later_s = batch.least(self.since_s + self._period_s, self.limits.give_back_s)
        since_s = batch.choose(fresh, 0.0, later_s)
        self.since_s = batch.choose(known, since_s, self.since_s)

    def _followed(self, wanted_n: Number) -> Number:
        """The wanted grip, where the target may go there."""
        batch = self._batch
        limits = self.limits
        is_fresh = self.since_s < limits.rise_s
        may_rise = is_fresh & (self.risen_s < limits.most_rise_s)

        # what no controller can want changes nothing; only NaN differs from itself
        wanted_n = batch.choose(wanted_n == wanted_n, wanted_n, self.given_n)
        # Without fresh evidence the target may still fall, and only rising is barred.
        capped_n = batch.within(0.0, wanted_n, limits.ceiling_n)
        lower_n = batch.least(capped_n, self.given_n)
        return batch.choose(may_rise, capped_n, lower_n)

    def _given_back(self, target_n: Number, holds_n: Number) -> Number:
        """The target after slow relaxing to the grip that holds."""
        batch = self._batch
        limits = self.limits
        less_n = target_n - limits.give_back_n_s * self._period_s

        # The grip that holds the load may be above the target: giving back must never tighten.
        floor_n = batch.least(holds_n, target_n)
        relaxed_n = batch.most(batch.most(less_n, floor_n), 0.0)
        stale = self.since_s >= limits.give_back_s
        return batch.choose(stale, relaxed_n, target_n)

    def _mode(self, target_n: Number, unknown: Flag, ends: Flag) -> Number:
        """The last rule that applies names the mode."""
        batch = self._batch
        before_n = self.given_n
        none = batch.choose(before_n > 0.0, YIELD, IDLE)

        mode = batch.choose(target_n < before_n, RELAX, HOLD)
        mode = batch.choose(target_n > before_n, TIGHTEN, mode)
        mode = batch.choose(target_n <= 0.0, none, mode)
        mode = batch.choose(unknown, HOLD, mode)
        return batch.choose(ends, none, mode)
