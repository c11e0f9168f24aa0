"""What reaches the hand: one grip command a sample, as one JSON line.

    {"sequence":812,"t_ns":5413333333,"mode":"tighten","target_n":9.4,"slew_n_s":400.0,
     "feedback":0.6,"reason":"risky slip","mu_hat":0.61,"margin":0.12,"expires_ms":300}

`docs/shared-control.md` has every field, and a receiver in Python and in C. A hand that has got no
line for expires_ms holds its grip.
"""

from __future__ import annotations

import json
from typing import Literal, NamedTuple

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
    margin, needed_n: friction margin (edge_runtime/friction.py), None while not observed. reason:
    one word or two, for people.
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
    rounded = [round(value, 4) if isinstance(value, float) else value for value in command]
    return _to_json(dict(zip(FIELDS, (*rounded, EXPIRES_MS), strict=True)))


def last_line(sequence: int, t_ns: int, reason: str) -> str:
    """The line that ends a run: the hand holds the grip that it has."""
    return to_line(GripCommand(sequence, t_ns, "hold", None, 0.0, 0.0, reason))
