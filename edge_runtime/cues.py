"""Vibration cues for the wearer: from one prediction to at most one cue.

A card (edge_runtime/cues.toml) gives each kind of cue a pattern. The cue of a sample is the first
of KINDS that applies and that the card has. It is sent when it has applied for `after_ms`, and
again every `repeat_ms`. No cue cuts off the one before, and at most `most_per_s` are sent in a
second. Urgent cues pass both rules, but never cut off another urgent one. A cue that has to wait is
sent only if it still applies then.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Mapping
from dataclasses import dataclass

from holdfast.edge_runtime.contract import Prediction

KINDS = ("unknown", "act", "arm", "risky_slip", "safe_slip", "grasp", "nothing")
"""The situations, and before them the decision's requests; the first that applies counts."""
UNKNOWN, QUIET = "unknown", "quiet"
SECOND_NS = 1_000_000_000
QUIET_NS = SECOND_NS
"""Where no cue was sent for so long, a line shows that the run goes on."""
EXPIRES_MS = 3000
"""A device that has got no line for so long knows nothing any more, as in `unknown`."""


@dataclass(frozen=True)
class Pattern:
    """What the motor does: pulses of on_ms with off_ms after each, at a strength of 0 to 1."""

    pulses: int
    on_ms: int
    off_ms: int
    strength: float

    @property
    def length_ns(self) -> int:
        """From its first pulse to the end of its last pause."""
        return 1_000_000 * self.pulses * (self.on_ms + self.off_ms)


SILENCE = Pattern(0, 0, 0, 0.0)


@dataclass(frozen=True)
class CueRule:
    """When a pattern is sent. repeat_ms: 0 for once."""

    pattern: Pattern
    after_ms: int = 0
    repeat_ms: int = 0
    urgent: bool = False


@dataclass(frozen=True)
class CueTable:
    """The rules by kind; a kind without one has no cue."""

    rules: Mapping[str, CueRule]
    most_per_s: int


class Cues:
    """Chooses the cues of one run; the clock is that of the predictions' t_decided_ns."""

    def __init__(self, table: CueTable) -> None:
        self._table = table
        self._kind: str | None = None
        self._since_ns = 0
        self._last_ns: int | None = None
        self._ends_ns, self._urgent_ends_ns = 0, 0
        self._recent_ns: deque[int] = deque(maxlen=table.most_per_s)

    def due(self, prediction: Prediction) -> str | None:
        """The kind of cue to send now, or None."""
        now_ns, kind = prediction.t_decided_ns, self._applies(prediction)
        if kind != self._kind:
            self._kind, self._since_ns, self._last_ns = kind, now_ns, None
        if kind is None:
            return None
        rule = self._table.rules[kind]
        if now_ns - self._since_ns < 1_000_000 * rule.after_ms:
            return None
        if self._last_ns is not None and (
            not rule.repeat_ms or now_ns - self._last_ns < 1_000_000 * rule.repeat_ms
        ):
            return None
        return kind if self._has_room(rule, now_ns) else None

    def sent(self, kind: str, now_ns: int) -> None:
        """The cue that was due has left."""
        rule = self._table.rules[kind]
        self._last_ns = now_ns
        self._ends_ns = now_ns + rule.pattern.length_ns
        if rule.urgent:
            self._urgent_ends_ns = self._ends_ns
        self._recent_ns.append(now_ns)

    def _applies(self, prediction: Prediction) -> str | None:
        now: set[str] = {prediction.state}
        if prediction.act:
            now.add("act")
        if prediction.arm:
            now.add("arm")
        return next((kind for kind in KINDS if kind in now and kind in self._table.rules), None)

    def _has_room(self, rule: CueRule, now_ns: int) -> bool:
        if rule.urgent:
            return now_ns >= self._urgent_ends_ns
        recent = self._recent_ns
        full = len(recent) == recent.maxlen and now_ns - recent[0] < SECOND_NS
        return now_ns >= self._ends_ns and not full


def cue_line(sequence: int, t_ns: int, kind: str, pattern: Pattern) -> str:
    """One JSON line of a cue, without a line end."""
    line = {
        "sequence": sequence,
        "t_ns": t_ns,
        "cue": kind,
        "pulses": pattern.pulses,
        "on_ms": pattern.on_ms,
        "off_ms": pattern.off_ms,
        "strength": pattern.strength,
        "expires_ms": EXPIRES_MS,
    }
    return json.dumps(line, separators=(",", ":"))
