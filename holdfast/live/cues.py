"""Vibration cues for the wearer: from one prediction to at most one cue.

A table (cues.toml here, or the user's) gives each kind of cue a pattern. The cue of a sample is the
first of KINDS that applies and that the table has. It is sent when it has applied for `after_ms`,
and again every `repeat_ms`. A cue waits until the one before has ended, and for a second divided by
`most_per_s` after its beginning. Urgent cues pass both rules, but never cut off another urgent one.
A cue that has to wait is sent only if it still applies then.

`feedback` in holdfast.toml sends the cues on a link of their own, which is opened again where it
fails (live/hand_link.py); the loop never waits for it. The last line is the cue `unknown`: nothing
looks after the grip any more.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from pathlib import Path
from typing import Annotated, Literal, get_args

import msgspec
from msgspec.json import encode

from holdfast.core.contract import Prediction
from holdfast.core.errors import DataNotFound
from holdfast.core.schema import read
from holdfast.live.hand_link import HandLink, open_hand_link
from holdfast.live.outputs import STOPPED

Kind = Literal["unknown", "act", "arm", "risky_slip", "safe_slip", "grasp", "nothing"]
KINDS: tuple[Kind, ...] = get_args(Kind)
"""The situations, and before them the decision's requests; the first that applies counts."""
UNKNOWN_CUE = KINDS[0]
QUIET = "quiet"
LONGEST_MS = 60_000
Milliseconds = Annotated[int, msgspec.Meta(ge=0, le=LONGEST_MS)]
MS_NS, SECOND_NS = 1_000_000, 1_000_000_000
QUIET_NS = SECOND_NS
"""Where no cue was sent for so long, a line shows that the run goes on."""
CUE_EXPIRES_MS = 3000
"""A device that has got no line for so long knows nothing any more, as in `unknown`."""
SHIPPED = Path(__file__).with_name("cues.toml")


class CueRule(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """What the motor does, and when: pulses of on_ms with off_ms after each.

    strength: 0 to 1. repeat_ms: 0 for once.
    """

    pulses: Annotated[int, msgspec.Meta(ge=1, le=10)]
    on_ms: Annotated[int, msgspec.Meta(ge=10, le=LONGEST_MS)]
    off_ms: Milliseconds
    strength: Annotated[float, msgspec.Meta(gt=0.0, le=1.0)]
    after_ms: Milliseconds = 0
    repeat_ms: Milliseconds = 0
    urgent: bool = False

    @property
    def length_ns(self) -> int:
        """From its first pulse to the end of its last pause."""
        return MS_NS * self.pulses * (self.on_ms + self.off_ms)

    @property
    def felt(self) -> tuple[int, int, int]:
        """Without its strength; the pause after a single pulse is not felt."""
        return self.pulses, self.on_ms, self.off_ms if self.pulses > 1 else 0


SILENCE = CueRule(0, 0, 0, 0.0)


class CueTable(msgspec.Struct, frozen=True, forbid_unknown_fields=True):
    """The rules by kind; a kind without one has no cue."""

    rules: dict[Kind, CueRule] = msgspec.field(name="cues")
    most_per_s: Annotated[int, msgspec.Meta(ge=1, le=10)]
    title: str = ""

    def __post_init__(self) -> None:
        """Raise ValueError where `unknown` is missing, or felt as another cue."""
        # without it, a hand that feels nothing is silent like a safe one
        if UNKNOWN_CUE not in self.rules:
            raise ValueError("no [cues.unknown]; allowed: a pattern of its own")
        # a wearer does not tell them apart by strength alone
        felt = [rule.felt for rule in self.rules.values()]
        if felt.count(self.rules[UNKNOWN_CUE].felt) > 1:
            raise ValueError(
                "a cue has the same pulses as [cues.unknown]; allowed: a pattern of its own"
            )


class Cues:
    """Chooses the cues of one run; times are of one clock, from 0 on."""

    def __init__(self, table: CueTable) -> None:
        self._rules = table.rules
        self._pause_ns = SECOND_NS // table.most_per_s
        self._kind: Kind | None = None
        self._due_ns: float = 0
        self._free_ns = 0
        self._urgent_free_ns = 0

    def due(self, state: str, act: bool, arm: bool, now_ns: int) -> Kind | None:
        """The kind of cue to send now, or None; act, arm: what the decision requests."""
        # a request and a state can apply at once; the order of KINDS decides between them
        now = {state, "act" if act else "", "arm" if arm else ""} & self._rules.keys()
        kind = next((kind for kind in KINDS if kind in now), None)

        before, self._kind = self._kind, kind
        if kind is None:
            return None

        rule = self._rules[kind]
        # a state that lasts only a moment is not worth the wearer's attention
        if kind != before:
            self._due_ns = now_ns + MS_NS * rule.after_ms

        # an urgent cue waits for urgent ones alone
        free_ns = self._urgent_free_ns if rule.urgent else self._free_ns
        return kind if now_ns >= max(free_ns, self._due_ns) else None

    def sent(self, kind: Kind, now_ns: int) -> None:
        """The cue that was due has left."""
        rule = self._rules[kind]
        ends_ns = now_ns + rule.length_ns
        # without repeat_ms: once, for as long as the same kind applies
        self._due_ns = now_ns + MS_NS * rule.repeat_ms if rule.repeat_ms else math.inf
        self._free_ns = max(ends_ns, now_ns + self._pause_ns)
        # later urgent cues must not cut this one off
        if rule.urgent:
            self._urgent_free_ns = ends_ns


def cue_line(sequence: int, t_ns: int, kind: str, rule: CueRule) -> str:
    """One JSON line of a cue, without a line end."""
    line = {
        "sequence": sequence,
        "t_ns": t_ns,
        "cue": kind,
        "pulses": rule.pulses,
        "on_ms": rule.on_ms,
        "off_ms": rule.off_ms,
        "strength": rule.strength,
        "expires_ms": CUE_EXPIRES_MS,
    }
    return encode(line).decode()


def read_cues(path: Path = SHIPPED) -> CueTable:
    """Read and check a table. Raises CardError, DataNotFound."""
    try:
        return read(path, CueTable)
    except FileNotFoundError:
        raise DataNotFound(
            "no such table of cues",
            where=path,
            next_step="docs/shared-control.md has the table",
        ) from None


class CueOutput:
    """The wearer's cues as an output of a run."""

    def __init__(self, link: HandLink, table: CueTable) -> None:
        self.link = link
        self._table = table
        self._cues = Cues(table)
        self._newest_ns = -QUIET_NS

    def write(
        self,
        prediction: Prediction,
        sample: object = None,
        reading: object = None,
        command: object = None,
    ) -> None:
        """Send the cue of one sample, or a sign of life where none was due for long."""
        if not self.link.works:
            # a cue that did not leave is due again
            self._cues = Cues(self._table)
        # a line never takes the place of a cue that has not left yet
        if not self.link.idle:
            return
        now_ns = prediction.t_decided_ns
        kind = self._cues.due(prediction.state, prediction.act, prediction.arm, now_ns)
        name, rule = QUIET, SILENCE
        if kind is not None:
            name, rule = kind, self._table.rules[kind]
            self._cues.sent(kind, now_ns)
        # without a line for EXPIRES_MS the device would go to `unknown` by itself
        elif now_ns - self._newest_ns < QUIET_NS:
            return
        line = cue_line(prediction.sequence, prediction.t_acquired_ns, name, rule)
        self.link(line, prediction.sequence)
        self._newest_ns = now_ns

    def close(self, reason: str = STOPPED) -> None:
        """Send the cue `unknown`: nothing looks after the grip any more."""
        self.link.close(reason)


def open_cues(
    url: str,
    path: str | Path,
    now_ns: Callable[[], int],
    report: Callable[[str], object],
) -> CueOutput:
    """The link of `feedback` with the patterns of `cues`, opened.

    Raises UsageError, DeviceError, OutputError, CardError, DataNotFound.
    """
    table = read_cues(Path(path))

    def last(sequence: int, t_ns: int, reason: str) -> str:
        # it ends the cues, or begins them after a failure: the state is not known
        return cue_line(sequence, t_ns, UNKNOWN_CUE, table.rules[UNKNOWN_CUE])

    effect = "the wearer feels no cue"
    return CueOutput(
        open_hand_link(url, "feedback", last, report, now_ns, effect), table
    )
