"""What may reach the hand: the last word on every wanted grip. The wearer always wins.

    the wearer overrides, or opens     yield: every request ends at once
    the state is unknown               hold: neither tighten nor relax, and no time passes
    the hand is empty                  idle
    a larger grip is wanted            tighten, up to the ceiling, while evidence is fresh (RISE_S)
                                       and not for longer than MOST_RISE_S an answer
    a smaller grip is wanted           relax
    no evidence for GIVE_BACK_S        relax slowly to the grip that is known to hold the load
                                       (holdfast/edge_runtime/grip_control.py)
    else                               hold

A controller remembers nothing of what it wanted: it receives what was given.

How long an override lasts is the decision's business (edge_runtime/decision.py), which every
prediction tells as `overridden`. The rules run on one hand or on many (edge_runtime/batch.py).
docs/safety.md has the invariants; tests/edge_runtime/test_supervisor.py searches every state.

What reaches the hand: one grip command a sample, as one JSON line.

    {"sequence":812,"t_ns":5413333333,"mode":"tighten","target_n":9.4,"slew_n_s":400.0,
     "feedback":0.6,"reason":"risky slip","mu_hat":0.61,"margin":0.12,"expires_ms":300}

`docs/shared-control.md` has every field, and a receiver in Python and in C. A hand that has got no
line for expires_ms holds its grip.
"""

from __future__ import annotations

import json
from dataclasses import dataclass
from typing import TYPE_CHECKING, Literal, NamedTuple

from holdfast.edge_runtime.batch import Flag, Lanes, Number

if TYPE_CHECKING:
    from holdfast.edge_runtime.grip import GripSense


Mode = Literal["idle", "hold", "tighten", "relax", "yield"]
MODES: tuple[Mode, ...] = ("idle", "hold", "tighten", "relax", "yield")
IDLE, HOLD, TIGHTEN, RELAX, YIELD = range(5)
EXPIRES_MS = 300


class GripCommand(NamedTuple):
    """What the hand should do now.

    mode: idle (nothing wanted: the wearer's own grip), hold (keep target_n), tighten, relax (give
    back slowly), yield (give back at once). target_n: normal force of either side, N; None where
    the hand keeps the grip it has: in idle and yield the wearer's own, in hold the present one.
    slew_n_s: no faster than this. feedback: strength of the wearer's vibration cue, 0 to 1. mu_hat,
    margin, needed_n: friction margin (grip_control.py), None while not observed.
    reason: one word or two, for people.
    """

    sequence: int
    t_ns: int
    mode: Mode
    target_n: float | None
    slew_n_s: float
    feedback: float
    reason: str
    mu_hat: float | None = None
    margin: float | None = None
    needed_n: float | None = None


FIELDS = (*GripCommand._fields, "expires_ms")
_to_json = json.JSONEncoder(separators=(",", ":")).encode


def to_line(command: GripCommand) -> str:
    """One JSON line, without a line end."""
    rounded = [
        round(value, 4) if isinstance(value, float) else value for value in command
    ]
    return _to_json(dict(zip(FIELDS, (*rounded, EXPIRES_MS), strict=True)))


def last_line(sequence: int, t_ns: int, reason: str) -> str:
    """The line that ends a run: the hand holds the grip that it has."""
    return to_line(GripCommand(sequence, t_ns, "hold", None, 0.0, 0.0, reason))


@dataclass(frozen=True)
class Limits:
    """What a hand allows: ceiling_n a side, slew_n_s; times in s; give_back_n_s: slow relaxing."""

    ceiling_n: float = 70.0
    slew_n_s: float = 400.0
    rise_s: float = 0.2
    most_rise_s: float = 2.0
    give_back_s: float = 1.0
    give_back_n_s: float = 10.0


class Supervisor:
    """given_n: the target that reaches the hand, N a side, 0 for none. mode: index of MODES."""

    def __init__(
        self, lanes: Lanes, rate_hz: float, limits: Limits | None = None
    ) -> None:
        self._lanes, self.limits, self._period_s = (
            lanes,
            limits or Limits(),
            1.0 / rate_hz,
        )
        self.given_n, self.risen_s = lanes.zero(), lanes.zero()
        self.since_s: Number = lanes.zero() + self.limits.give_back_s
        self.mode: Number = lanes.zero() + HOLD

    def step(
        self, sense: GripSense, wanted_n: Number, fresh: Flag, holds_n: Number
    ) -> Number:
        """The target after one sample; sets `mode`.

        wanted_n: by the controller, N a side, 0 for none. fresh: it has evidence at this sample.
        holds_n: the grip that is known to hold the load.
        """
        lanes = self._lanes
        ends = sense.opening | sense.overridden | (sense.known & sense.empty)
        unknown = lanes.no(sense.known)
        self._pass_time(sense.known, fresh)
        target_n = self._given_back(self._followed(wanted_n), holds_n)
        target_n = lanes.choose(unknown, self.given_n, target_n)
        target_n = lanes.choose(ends, 0.0, target_n)
        rises = target_n > self.given_n
        self.risen_s = lanes.choose(rises, self.risen_s + self._period_s, self.risen_s)
        over = (target_n <= 0.0) | (self.since_s >= self.limits.give_back_s)
        self.risen_s = lanes.choose(over, 0.0, self.risen_s)
        self._choose_mode(target_n, unknown, ends)
        self.given_n = target_n
        return target_n

    def _pass_time(self, known: Flag, fresh: Flag) -> None:
        """Time since the last evidence; it stands still while the state is unknown."""
        lanes = self._lanes
        later_s = lanes.least(self.since_s + self._period_s, self.limits.give_back_s)
        since_s = lanes.choose(fresh, 0.0, later_s)
        self.since_s = lanes.choose(known, since_s, self.since_s)

    def _followed(self, wanted_n: Number) -> Number:
        """The wanted grip, where the target may go there."""
        lanes, limits = self._lanes, self.limits
        may_rise = (self.since_s < limits.rise_s) & (self.risen_s < limits.most_rise_s)
        capped_n = lanes.least(wanted_n, limits.ceiling_n)
        return lanes.choose(may_rise, capped_n, lanes.least(capped_n, self.given_n))

    def _given_back(self, target_n: Number, holds_n: Number) -> Number:
        """The target after slow relaxing to the grip that holds."""
        lanes, limits = self._lanes, self.limits
        stale = self.since_s >= limits.give_back_s
        less_n = target_n - limits.give_back_n_s * self._period_s
        floor_n = lanes.least(holds_n, target_n)
        return lanes.choose(
            stale, lanes.most(lanes.most(less_n, floor_n), 0.0), target_n
        )

    def _choose_mode(self, target_n: Number, unknown: Flag, ends: Flag) -> None:
        lanes, before_n = self._lanes, self.given_n
        mode = lanes.choose(target_n < before_n, RELAX, HOLD)
        mode = lanes.choose(target_n > before_n, TIGHTEN, mode)
        mode = lanes.choose(
            target_n <= 0.0, lanes.choose(before_n > 0.0, YIELD, IDLE), mode
        )
        mode = lanes.choose(unknown, HOLD, mode)
        self.mode = lanes.choose(ends, lanes.choose(before_n > 0.0, YIELD, IDLE), mode)
