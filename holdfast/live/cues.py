"""Vibration cues for the wearer: from one prediction to at most one cue.

A table (cues.toml here, or the user's) gives each kind of cue a pattern. The cue of a sample is the
first of KINDS that applies and that the table has. It is sent when it has applied for `after_ms`,
and again every `repeat_ms`. No cue cuts off the one before, and at most `most_per_s` are sent in a
second. Urgent cues pass both rules, but never cut off another urgent one. A cue that has to wait is
sent only if it still applies then.

`holdfast run --feedback URL` sends the cues on a separate wire. A wire that fails is reported and
tried again (live/wire.py); the loop never waits for it. The last line is the cue `unknown`: nothing
looks after the grip any more.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from holdfast.core.contract import Json, Prediction
from holdfast.core.errors import CardError, DataNotFound
from holdfast.core.reading import CardReader, read_toml
from holdfast.live.outputs import STOPPED
from holdfast.live.wire import Wire, open_wire

if TYPE_CHECKING:
    from holdfast.edge_runtime.recording import Answers, TextArray

KINDS = ("unknown", "act", "arm", "risky_slip", "safe_slip", "grasp", "nothing")
"""The situations, and before them the decision's requests; the first that applies counts."""
UNKNOWN = "unknown"
QUIET = "quiet"
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
        self._ends_ns = 0
        self._urgent_ends_ns = 0
        self._recent_ns: deque[int] = deque(maxlen=table.most_per_s)

    def due(self, prediction: Prediction) -> str | None:
        """The kind of cue to send now, or None."""
        kind = self._applies(prediction.state, prediction.arm, prediction.act)
        return self.due_of(kind, prediction.t_decided_ns)

    def of_recording(self, answers: Answers) -> TextArray:
        """[T] the kind of cue that is sent at a sample, "" for none. Computing takes no time."""
        t_ns = np.round(answers.t_s * 1e9).astype(np.int64)
        sent = []
        for row in range(len(t_ns)):
            now_ns = int(t_ns[row])
            state = str(answers.state[row])
            applies = self._applies(state, answers.arm[row], answers.act[row])
            kind = self.due_of(applies, now_ns)
            if kind is not None:
                self.sent(kind, now_ns)
            sent.append(kind or "")
        return np.array(sent)

    def due_of(self, kind: str | None, now_ns: int) -> str | None:
        """The same, of the kind that applies now."""
        if kind != self._kind:
            self._kind = kind
            self._since_ns = now_ns
            self._last_ns = None

        if kind is None:
            return None

        rule = self._table.rules[kind]
        # a state that lasts only a moment is not worth the wearer's attention
        if now_ns - self._since_ns < 1_000_000 * rule.after_ms:
            return None
        if self._last_ns is not None:
            silent_ns = now_ns - self._last_ns
            # 0: once, for as long as the same kind applies
            if not rule.repeat_ms or silent_ns < 1_000_000 * rule.repeat_ms:
                return None

        return kind if self._has_room(rule, now_ns) else None

    def sent(self, kind: str, now_ns: int) -> None:
        """The cue that was due has left."""
        rule = self._table.rules[kind]
        self._last_ns = now_ns
        self._ends_ns = now_ns + rule.pattern.length_ns
        # later urgent cues must not cut this one off
        if rule.urgent:
            self._urgent_ends_ns = self._ends_ns
        self._recent_ns.append(now_ns)

    def _applies(self, state: str, arm: bool, act: bool) -> str | None:
        now = {state}
        # a request and a state can apply at once; the order of KINDS decides between them
        if act:
            now.add("act")
        if arm:
            now.add("arm")

        for kind in KINDS:
            if kind in now and kind in self._table.rules:
                return kind

        return None

    def _has_room(self, rule: CueRule, now_ns: int) -> bool:
        if rule.urgent:
            return now_ns >= self._urgent_ends_ns
        # the oldest of the last most_per_s cues tells whether all of them fell into one second
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


SHIPPED = Path(__file__).with_name("cues.toml")
SECTIONS = ("title", "most_per_s", "cues")
KEYS = ("pulses", "on_ms", "off_ms", "strength", "after_ms", "repeat_ms", "urgent")
MOST_PER_S = 10
MOST_PULSES = 10
SHORTEST_MS = 10
LONGEST_MS = 60_000


def read_cues(path: Path = SHIPPED) -> CueTable:
    """Read and check a table. Raises CardError, DataNotFound."""
    try:
        _, raw = read_toml(path)
    except FileNotFoundError:
        raise DataNotFound(
            "no such table of cues",
            where=path,
            next_step="docs/feedback.md has the table",
        ) from None

    return _CueReader(path).cues(raw)


class _CueReader(CardReader):
    """Checks one table of cues."""

    def cues(self, raw: Json) -> CueTable:
        self.require_known(raw, SECTIONS, "section")
        tables = self.table(raw, "cues")
        self.require_known(tables, KINDS, "[cues]")

        rules = {}
        for name, table in tables.items():
            key = f"cues.{name}"
            rules[name] = self.rule(key, self.require_table(key, table))

        self._require_distinct_unknown(rules)
        most = self.whole("most_per_s", raw.get("most_per_s"), 1, MOST_PER_S)
        return CueTable(rules, most)

    def rule(self, key: str, table: Json) -> CueRule:
        self.require_known(table, KEYS, key)
        pulses = self.whole(f"{key}.pulses", table.get("pulses"), 1, MOST_PULSES)
        # several pulses without a pause between them would be felt as one
        shortest_off_ms = SHORTEST_MS if pulses > 1 else 0
        urgent = table.get("urgent", False)
        if not isinstance(urgent, bool):
            raise self.refused(f"{key}.urgent", urgent, "true or false")

        def duration(name: str, default: int | None, shortest: int) -> int:
            value = table.get(name, default)
            return self.whole(f"{key}.{name}", value, shortest, LONGEST_MS)

        on_ms = duration("on_ms", None, SHORTEST_MS)
        off_ms = duration("off_ms", None, shortest_off_ms)
        strength = self.strength(f"{key}.strength", table.get("strength"))
        after_ms = duration("after_ms", 0, 0)
        repeat_ms = duration("repeat_ms", 0, 0)
        pattern = Pattern(pulses, on_ms, off_ms, strength)
        return CueRule(pattern, after_ms, repeat_ms, urgent)

    def whole(self, key: str, value: Any, least: int, most: int) -> int:
        # in Python, true is an int
        is_whole = isinstance(value, int) and not isinstance(value, bool)
        if not is_whole or not least <= value <= most:
            raise self.refused(key, value, f"a whole number from {least} to {most}")
        return int(value)

    def strength(self, key: str, value: Any) -> float:
        is_number = isinstance(value, int | float) and not isinstance(value, bool)
        if not is_number or not 0.0 < value <= 1.0:
            raise self.refused(key, value, "a number above 0, at most 1")
        return float(value)

    def _require_distinct_unknown(self, rules: dict[str, CueRule]) -> None:
        """The wearer must feel that the state is not known, and take it for nothing else."""
        if UNKNOWN not in rules:
            raise CardError(
                "no [cues.unknown]",
                where=self.path,
                cause="without it, a hand that feels nothing is silent like a safe one",
                next_step="give it a pattern",
            )

        felt = _felt(rules[UNKNOWN].pattern)
        for name, rule in rules.items():
            if name != UNKNOWN and _felt(rule.pattern) == felt:
                raise CardError(
                    f"[cues.{name}] and [cues.unknown] have the same pulses",
                    where=self.path,
                    cause="a wearer does not tell them apart by strength alone",
                    next_step="give unknown another pattern",
                )


def _felt(pattern: Pattern) -> tuple[int, int, int]:
    """A pattern without its strength; the pause after a single pulse is not felt."""
    return pattern.pulses, pattern.on_ms, pattern.off_ms if pattern.pulses > 1 else 0


class CueOutput:
    """The wearer's cues as an output of a run."""

    def __init__(self, wire: Wire, table: CueTable) -> None:
        self._wire = wire
        self._table = table
        self._cues = Cues(table)
        self._newest_ns: int | None = None

    def write(
        self, prediction: Prediction, sample: object = None, reading: object = None
    ) -> None:
        """Send the cue of one sample, or a sign of life where none was due for long."""
        now_ns = prediction.t_decided_ns
        kind = self._cues.due(prediction)
        if kind is not None:
            # a cue that did not leave stays due
            if self._send(prediction, kind, self._table.rules[kind].pattern):
                self._cues.sent(kind, now_ns)
        # without a line for EXPIRES_MS the device would go to `unknown` by itself
        elif self._newest_ns is None or now_ns - self._newest_ns >= QUIET_NS:
            self._send(prediction, QUIET, SILENCE)
        else:
            # no line to send: a broken wire is noticed and opened again all the same
            self._wire.look(prediction.sequence)

    def close(self, reason: str = STOPPED) -> None:
        """Send the cue `unknown`: nothing looks after the grip any more."""
        self._wire.close(reason)

    def _send(self, prediction: Prediction, kind: str, pattern: Pattern) -> bool:
        line = cue_line(prediction.sequence, prediction.t_acquired_ns, kind, pattern)
        taken = self._wire(line, prediction.sequence)
        if taken:
            self._newest_ns = prediction.t_decided_ns
        return taken


def open_cues(
    url: str,
    path: Path | None,
    now_ns: Callable[[], int],
    report: Callable[[str], object],
) -> CueOutput:
    """The wire of --feedback with the patterns of --cues, opened.

    Raises UsageError, DeviceError, OutputError, CardError, DataNotFound.
    """
    table = read_cues(path or SHIPPED)
    effect = "the wearer feels no cue"
    last = partial(last_cue, table)
    wire = open_wire(url, "--feedback", last, report, now_ns, effect)
    return CueOutput(wire, table)


def last_cue(table: CueTable, sequence: int, t_ns: int, reason: str) -> str:
    """The line that ends the cues, or begins them after a failure: the state is not known."""
    return cue_line(sequence, t_ns, UNKNOWN, table.rules[UNKNOWN].pattern)
