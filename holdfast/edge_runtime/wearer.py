"""What the wearer wants, as a stream of words next to the sensors: open, close, stop.

    {"wants": "open"}                   stop: neither opening nor closing

The hand's own controller makes the words, from muscle signals for instance, and obeys them itself
before any target (GripCommand). They come to the run so that its answer ends there too. A stream
that has been silent for EXPIRES_NS means `unknown`, never that the hand should close. The word
`override` counts for the sample at which it came: it ends every request and blocks new ones for a
while (decision.py).

The same as a file of a trial (trial_n.intent.csv, tactile.intent.csv):

    Time (s),host (ns),wants

Time counts from the trial's first sample; host is CLOCK_MONOTONIC, as in tactile.csv. Where the
stream goes silent, a line has `unknown`.
"""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from holdfast.core.contract import Command, CommandLink
from holdfast.core.errors import NotANumber
from holdfast.core.hand_lines import SILENCE_NS
from holdfast.core.schema import text_of

WORDS = ("open", "close", "stop", "override")
UNKNOWN_INTENT = "unknown"
EXPIRES_NS = SILENCE_NS
"""The word of a sender that has been silent for longer expires."""
INTENT_HEADER = "Time (s),host (ns),wants"
"""The first line of a file, without its line end."""


class Intent(NamedTuple):
    """One item of a stream, with its time on the run's clock: one of WORDS, or UNKNOWN."""

    t_ns: int
    wants: str


Words = Callable[[], list[Intent]]
"""A stream: what came since the last call, oldest first; it never waits."""


class IntentMonitor:
    """Follows a stream. newest: the last item, `unknown` before the first and after a silence.

    fresh: the items of the last sample, as they are recorded. log: receives a line when the stream
    goes silent and when it is back.
    """

    def __init__(
        self, words: Words, now_ns: Callable[[], int], log: Callable[[str], object]
    ) -> None:
        self._words = words
        self._now_ns = now_ns
        self._log = log
        self._looked_ns: int | None = None
        self.link: CommandLink = "none"
        self.newest = Intent(0, UNKNOWN_INTENT)
        self.fresh: list[Intent] = []

    def command(self) -> Command:
        """Look, and what is commanded at this sample. Call it once a sample."""
        self.look()
        override = any(item.wants == "override" for item in self.fresh)
        return Command(self.newest.wants == "open", override, self.link)

    def look(self) -> None:
        """Take what came. Call it once a sample."""
        now_ns = self._now_ns()
        self.fresh = self._words()
        # what waited while nothing looked has no known time
        if self._looked_ns is None or now_ns - self._looked_ns > EXPIRES_NS:
            while self.fresh:
                self.fresh = self._words()
        self._looked_ns = now_ns

        if self.fresh:
            if self.link == "expired":
                self._log("wearer: the stream is back")
            self.newest = self.fresh[-1]
            self.link = "live"
        if self.link == "live" and now_ns - self.newest.t_ns > EXPIRES_NS:
            self._log("wearer: the stream is silent; what the wearer wants is unknown")
            self.link = "expired"
            self.newest = Intent(now_ns, UNKNOWN_INTENT)
            self.fresh.append(self.newest)


def intent_of(wants: object, t_ns: int) -> Intent:
    """What a word of the wearer's asks for. Raises ValueError for no such word."""
    if wants not in WORDS:
        raise ValueError(f"wants is one of {', '.join(WORDS)}")
    return Intent(t_ns, str(wants))


def intent_row(item: Intent, first_ns: int, host_after_ns: int) -> str:
    """A line. first_ns: of the first sample. host_after_ns: the host's clock minus the run's."""
    time_s = 1e-9 * (item.t_ns - first_ns)
    return f"{time_s:.6f},{item.t_ns + host_after_ns},{item.wants}"


def read_intent(path: Path) -> list[Intent]:
    """The words of a file, with ns from the trial's first sample. Raises NotANumber, OSError.

    A torn last line, as a kill leaves it, is not read; nor are the envelopes of older files.
    """
    items = []
    # the first line has names; what follows the last line end is torn, or empty
    for number, line in enumerate(text_of(path).split("\n")[1:-1], start=2):
        try:
            time_s, _, wants = line.rstrip("\r").split(",")[:3]
            # older files say so
            wants = "stop" if wants == "rest" else wants
            if wants not in (UNKNOWN_INTENT, ""):
                items.append(intent_of(wants, round(1e9 * float(time_s))))
        except ValueError as error:
            next_step = f"correct it, or choose a file that begins with {INTENT_HEADER}"
            what = f"line {number}: {error}"
            raise NotANumber(what, where=path, next_step=next_step) from None
    return items
