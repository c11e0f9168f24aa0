"""Vibration cues for the wearer: from one prediction to at most one cue.

A table (cues.toml here, or the user's) gives each kind of cue a pattern. The cue of a sample is the
first of KINDS that applies and that the table has. It is sent when it has applied for `after_ms`,
and again every `repeat_ms`. No cue cuts off the one before, and at most `most_per_s` are sent in a
second. Urgent cues pass both rules, but never cut off another urgent one. A cue that has to wait is
sent only if it still applies then.

`holdfast run --feedback URL` sends the cues on a link of their own, which is opened again where it
fails (live/hand_link.py); the loop never waits for it. The last line is the cue `unknown`: nothing
looks after the grip any more.
"""

from __future__ import annotations

import json
from collections import deque
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Annotated

import msgspec
import numpy as np

from holdfast.core.contract import Prediction
from holdfast.core.errors import CardError, DataNotFound
from holdfast.core.schema import read
from holdfast.live.hand_link import HandLink, open_hand_link
from holdfast.live.outputs import STOPPED

if TYPE_CHECKING:
    from holdfast.edge_runtime.recording import Answers, TextArray

KINDS = ("unknown", "act", "arm", "risky_slip", "safe_slip", "grasp", "nothing")
"""The situations, and before them the decision's requests; the first that applies counts."""
UNKNOWN = "unknown"
QUIET = "quiet"
SHORTEST_PAUSE_MS, LONGEST_MS = 10, 60_000
Milliseconds = Annotated[int, msgspec.Meta(ge=0, le=LONGEST_MS)]
SECOND_NS = 1_000_000_000
QUIET_NS = SECOND_NS
"""Where no cue was sent for so long, a line shows that the run goes on."""
EXPIRES_MS = 3000
"""A device that has got no line for so long knows nothing any more, as in `unknown`."""


class Pattern(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the motor does: pulses of on_ms with off_ms after each, at a strength of 0 to 1."""

    pulses: Annotated[int, msgspec.Meta(ge=1, le=10)]
    on_ms: Annotated[int, msgspec.Meta(ge=10, le=LONGEST_MS)]
    off_ms: Milliseconds
    strength: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]

    @property
    def length_ns(self) -> int:
        """From its first pulse to the end of its last pause."""
        return 1_000_000 * self.pulses * (self.on_ms + self.off_ms)

    @property
    def felt(self) -> tuple[int, int, int]:
        """Without its strength; the pause after a single pulse is not felt."""
        return self.pulses, self.on_ms, self.off_ms if self.pulses > 1 else 0


SILENCE = Pattern(0, 0, 0, 0.0)


class CueRule(Pattern, frozen=True):
    """A pattern and when it is sent. repeat_ms: 0 for once."""

    after_ms: Milliseconds = 0
    repeat_ms: Milliseconds = 0
    urgent: bool = False


class CueTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rules by kind; a kind without one has no cue."""

    rules: dict[str, CueRule] = msgspec.field(name="cues")
    most_per_s: Annotated[int, msgspec.Meta(ge=1, le=10)]
    title: str = ""


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
        self._ends_ns = now_ns + rule.length_ns
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


def read_cues(path: Path = SHIPPED) -> CueTable:
    """Read and check a table. Raises CardError, DataNotFound."""
    try:
        table = read(path, CueTable)
    except FileNotFoundError:
        raise DataNotFound(
            "no such table of cues",
            where=path,
            next_step="docs/shared-control.md has the table",
        ) from None
    _require_felt(table, path)
    return table


def _require_felt(table: CueTable, path: Path) -> None:
    """Every cue must be felt as what it is, and that the state is not known as nothing else."""
    for kind, rule in table.rules.items():
        if kind not in KINDS:
            known = f"allowed: {', '.join(KINDS)}"
            raise CardError(f"cues.{kind} is not known", where=path, next_step=known)
        if rule.pulses > 1 and rule.off_ms < SHORTEST_PAUSE_MS:
            what = f"cues.{kind}.off_ms = {rule.off_ms}: pulses without a pause are felt as one"
            step = f"{SHORTEST_PAUSE_MS} or more"
            raise CardError(what, where=path, next_step=step)

    if UNKNOWN not in table.rules:
        raise CardError(
            "no [cues.unknown]",
            where=path,
            cause="without it, a hand that feels nothing is silent like a safe one",
            next_step="give it a pattern",
        )
    felt = table.rules[UNKNOWN].felt
    for kind, rule in table.rules.items():
        if kind != UNKNOWN and rule.felt == felt:
            raise CardError(
                f"[cues.{kind}] and [cues.unknown] have the same pulses",
                where=path,
                cause="a wearer does not tell them apart by strength alone",
                next_step="give unknown another pattern",
            )


class CueOutput:
    """The wearer's cues as an output of a run."""

    def __init__(self, link: HandLink, table: CueTable) -> None:
        self._link = link
        self._table = table
        self._cues = Cues(table)
        self._newest_ns: int | None = None

    def write(
        self, prediction: Prediction, sample: object = None, reading: object = None
    ) -> None:
        """Send the cue of one sample, or a sign of life where none was due for long."""
        if not self._link.works:
            # a cue that did not leave is due again
            self._cues = Cues(self._table)
        # a line never takes the place of a cue that has not left yet
        if not self._link.idle:
            return
        now_ns = prediction.t_decided_ns
        kind = self._cues.due(prediction)
        if kind is not None:
            self._send(prediction, kind, self._table.rules[kind])
            self._cues.sent(kind, now_ns)
        # without a line for EXPIRES_MS the device would go to `unknown` by itself
        elif self._newest_ns is None or now_ns - self._newest_ns >= QUIET_NS:
            self._send(prediction, QUIET, SILENCE)

    def close(self, reason: str = STOPPED) -> None:
        """Send the cue `unknown`: nothing looks after the grip any more."""
        self._link.close(reason)

    def _send(self, prediction: Prediction, kind: str, pattern: Pattern) -> None:
        line = cue_line(prediction.sequence, prediction.t_acquired_ns, kind, pattern)
        self._link(line, prediction.sequence)
        self._newest_ns = prediction.t_decided_ns


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
    link = open_hand_link(url, "--feedback", last, report, now_ns, effect)
    return CueOutput(link, table)


def last_cue(table: CueTable, sequence: int, t_ns: int, reason: str) -> str:
    """The line that ends the cues, or begins them after a failure: the state is not known."""
    return cue_line(sequence, t_ns, UNKNOWN, table.rules[UNKNOWN])
