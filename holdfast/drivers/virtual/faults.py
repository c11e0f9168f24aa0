"""Scripted faults: what goes wrong, with which sensor, when, for how long.

nack:3@1.5+0.2      sensor 3 does not acknowledge from 1.5 s on for 0.2 s
unplug@2+1          the bridge is gone for a second
"""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Protocol

from holdfast.core.errors import UsageError

# Time of the virtual hand: it passes when a bridge or a test spends it.


class Clock(Protocol):
    """The time by which a chip converts and that a bridge's transfers take."""

    def now_ns(self) -> int:
        """Monotonic time, in ns."""
        ...

    def spend(self, duration_ns: int) -> None: ...


class VirtualClock:
    """Stands still until time is spent, so a minute passes as fast as it is computed."""

    def __init__(self, start_ns: int = 0) -> None:
        self._now_ns = start_ns

    def now_ns(self) -> int:
        return self._now_ns

    def spend(self, duration_ns: int) -> None:
        """Let time pass at once."""
        self._now_ns += max(0, duration_ns)

    def wait_until(self, t_ns: int) -> None:
        """Let time pass until t_ns."""
        self._now_ns = max(self._now_ns, t_ns)


OF_A_SENSOR = {
    "nack": "acknowledges nothing",
    "frozen": "converts no more",
    "por": "loses its power for an instant, and with it its configuration and address",
    "sleep": "has fallen asleep or stopped, as after a stray write",
    "wrong": "another chip answers at its address",
    "diag": "reports that its own diagnosis failed",
}
OF_THE_BUS = {
    "stuck": "SDA is held low until nine clocks are given",
    "noise": "flips one bit in ten thousand on the wire, of any sender",
}
OF_THE_BRIDGE = {
    "stall": "answers a transfer with STALL",
    "late": "lets a transfer time out and answers it afterwards",
    "short": "answers with half of the bytes",
    "unplug": "is gone from USB",
}
KINDS = {**OF_A_SENSOR, **OF_THE_BUS, **OF_THE_BRIDGE}
AT_ONCE = ("por", "sleep", "stuck")
"""These faults happen once, at their time; the others last."""
FORM = re.compile(
    r"(?P<kind>[a-z]+)(:(?P<sensor>[1-9]\d?))?@(?P<at>\d+(\.\d+)?)(\+(?P<lasts>\d+(\.\d+)?))?"
)
DEFAULT_LASTS_S = 0.1


@dataclass(frozen=True)
class Fault:
    """One fault; sensor 1 .. n, None for bus or bridge; times in s since the hand was made."""

    kind: str
    at_s: float
    lasts_s: float = DEFAULT_LASTS_S
    sensor: int | None = None


def read_fault(text: str) -> Fault:
    """A fault as a URL or a file has it. Raises UsageError.

    >>> read_fault("nack:3@1.5+0.2")
    Fault(kind='nack', at_s=1.5, lasts_s=0.2, sensor=3)
    """
    # in a URL an unescaped + is a space
    found = FORM.fullmatch(text.replace(" ", "+"))
    if found is None or found["kind"] not in KINDS:
        raise UsageError(
            f"{text!r} is not a fault",
            next_step=f"write kind:sensor@at+lasts; kinds: {', '.join(KINDS)}",
        )
    kind = found["kind"]
    if (kind in OF_A_SENSOR) != (found["sensor"] is not None):
        raise UsageError(
            f"{text!r}: a sensor, 1 .. n, belongs to {', '.join(OF_A_SENSOR)} alone",
            next_step=f"such as {kind}:3@1+0.2 or {kind}@1+0.2",
        )
    lasts_s = float(found["lasts"]) if found["lasts"] else DEFAULT_LASTS_S
    sensor = int(found["sensor"]) if found["sensor"] else None
    return Fault(kind, float(found["at"]), lasts_s, sensor)


class Faults:
    """The script, which the parts of a virtual hand query as time goes by.

    born_ns: when the hand was made; the times of the faults begin then.
    """

    def __init__(self, clock: Clock, faults: Iterable[Fault] = ()) -> None:
        self.born_ns = clock.now_ns()
        self._clock = clock
        self._pending: list[Fault] = []
        self._lasting: dict[tuple[str, int | None], list[Fault]] = {}
        for fault in faults:
            if fault.kind in AT_ONCE:
                self._pending.append(fault)
            else:
                same = self._lasting.setdefault((fault.kind, fault.sensor), [])
                same.append(fault)

    def __bool__(self) -> bool:
        """Whether the script has any fault left."""
        return bool(self._lasting or self._pending)

    def now_s(self) -> float:
        """Time since the hand was made."""
        return 1e-9 * (self._clock.now_ns() - self.born_ns)

    def lasts(self, kind: str, sensor: int | None = None) -> bool:
        """Whether a lasting fault is active."""
        now_s = self.now_s()
        for fault in self._lasting.get((kind, sensor), ()):
            if fault.at_s <= now_s < fault.at_s + fault.lasts_s:
                return True
        return False

    def happened(self, kind: str, sensor: int | None = None) -> bool:
        """Whether a fault that happens once has happened since the last call."""
        happened = False
        for fault in list(self._pending):
            same = fault.kind == kind and fault.sensor == sensor
            if same and fault.at_s <= self.now_s():
                self._pending.remove(fault)
                happened = True
        return happened
