"""Commands of the wearer's control, as datagrams: {"opening": true}, {"override": true}.

opening lasts until a line takes it back, or until no line has come for EXPIRES_NS. So a sender
repeats its command, or sends a line without either to show that it is still there. override counts
for the sample at which it came; the decision (edge_runtime/decision.py) sets how long it then
lasts. Which lines count is the business of core/hand_lines.py. Commands have a log of their own.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass

from holdfast.core.contract import CommandLink, Json
from holdfast.core.hand_lines import SILENCE_NS, LinePort, line_port, printable

KEYS = {"opening", "override"}
EXPIRES_NS = SILENCE_NS
"""The command of a sender that has been silent for longer expires."""


@dataclass(frozen=True)
class Command:
    """What the wearer commands at a sample.

    opening ends an act and prevents a new one; override ends every request and blocks new ones for
    a while. link: whether commands have come at all, and whether they still come.
    """

    opening: bool = False
    override: bool = False
    link: CommandLink = "none"


@contextmanager
def command_port(
    address: str, log: Callable[[str], None], now_ns: Callable[[], int]
) -> Iterator[Callable[[], Command]]:
    """Listen at unix:///PATH.

    The function that it yields is called once a sample and never waits. log: receives lines about
    commands that change something, about lines that are skipped, and about a sender that goes
    silent. now_ns: monotonic. Raises UsageError where it cannot listen.
    """
    with line_port(address, "commands", log, now_ns) as port:
        yield _Listener(port, log, now_ns).ask


class _Listener:
    """What is commanded, and when a line last came."""

    def __init__(
        self, port: LinePort, log: Callable[[str], None], now_ns: Callable[[], int]
    ) -> None:
        self._port = port
        self._log = log
        self._now_ns = now_ns
        self._opening = False
        self._last_ns: int | None = None
        self._link: CommandLink = "none"

    def ask(self) -> Command:
        """The command at this sample."""
        # an override among many lines of one sample must not be lost
        override = False
        for keys, line in self._port.came(_read):
            override |= self._take(keys, line)
        if self._last_ns is not None and self._now_ns() - self._last_ns > EXPIRES_NS:
            self._expire()
        return Command(self._opening, override, self._link)

    def _take(self, keys: dict[str, bool], line: bytes) -> bool:
        """Take one line; whether it overrides."""
        self._last_ns = self._now_ns()
        self._link = "live"
        override = keys.get("override", False)
        opening = keys.get("opening", self._opening)
        if override or opening != self._opening:
            self._log(f"command: {printable(line)}")

        self._opening = opening
        return override

    def _expire(self) -> None:
        """Forget what was commanded: a silent sender may be gone."""
        self._log("command: the sender is silent; its last command has expired")
        self._opening = False
        self._last_ns = None
        self._link = "expired"


def _read(fields: Json) -> dict[str, bool]:
    """The known keys with true or false. Raises ValueError."""
    if not set(fields) <= KEYS:
        raise ValueError("neither opening nor override")
    if not all(isinstance(value, bool) for value in fields.values()):
        raise ValueError("neither true nor false")
    return fields
