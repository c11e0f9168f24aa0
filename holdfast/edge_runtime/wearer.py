"""What the wearer wants, as a stream of words next to the sensors: open, close, stop.

    {"wants": "open"}                   stop: neither opening nor closing

The hand's own controller makes the words, from muscle signals for instance. A stream that has been
silent for EXPIRES_NS means `unknown`, never that the hand should close. An opening that lasts for
MOST_OPEN_NS no longer counts until it has ended: an electrode that has come off reads like one. The
word `override` counts for the sample at which it came: it ends every request and blocks new ones
for a while (decision.py).

The same as a file of a trial (trial_n.intent.csv, tactile.intent.csv):

    Time (s),host (ns),wants

Older files have further columns, which are not read, and `rest` for `stop`. Time counts from the
trial's first sample; host is CLOCK_MONOTONIC, as in tactile.csv. Where the stream goes silent, a
line has `unknown`. A torn last line, as a kill leaves it, is not read.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from holdfast.core.contract import CommandLink
from holdfast.core.errors import ColumnError, NotANumber
from holdfast.core.hand_lines import SILENCE_NS
from holdfast.core.schema import text_of

Wants = Literal["open", "close", "stop", "override", "unknown", ""]
"""What the wearer wants; "" in an older file, where only envelopes were recorded."""
WORDS: tuple[Wants, ...] = ("open", "close", "stop", "override")
IN_FILE: tuple[Wants, ...] = ("", "unknown", *WORDS)
OLDER_STOP = "rest"
EXPIRES_NS = SILENCE_NS
"""The word of a sender that has been silent for longer expires."""
MOST_OPEN_NS = 3_000_000_000
"""A hand opens within half a second, and a receiver takes what it holds: longer, it is a fault."""


@dataclass(frozen=True)
class Command:
    """What the wearer commands at a sample.

    opening ends an act and prevents a new one; override ends every request and blocks new ones for
    a while. link: whether words have come at all, and whether they still come.
    """

    opening: bool = False
    override: bool = False
    link: CommandLink = "none"


@dataclass(frozen=True)
class Intent:
    """One item of a stream, with its time on the run's clock."""

    t_ns: int
    wants: Wants


class IntentStream(Protocol):
    """Where items come from."""

    def came(self) -> list[Intent]:
        """What came since the last call, oldest first; never waits."""
        ...

    def forget(self) -> None:
        """Drop what came before now."""
        ...


class IntentMonitor:
    """Follows a stream. newest: the last item, `unknown` before the first and after a silence.

    fresh: the items of the last sample, as they are recorded. log: receives a line when the stream
    goes silent and when it is back.
    """

    def __init__(
        self,
        stream: IntentStream,
        now_ns: Callable[[], int],
        log: Callable[[str], object],
    ) -> None:
        self._stream = stream
        self._now_ns = now_ns
        self._log = log
        self._opened_ns = 0
        self._stuck = False
        self._looked_ns: int | None = None
        self.link: CommandLink = "none"
        self.newest = Intent(0, "unknown")
        self.fresh: list[Intent] = []

    @property
    def opening(self) -> bool:
        """Whether the wearer wants to open the hand, as far as that is known and can be meant."""
        return self.newest.wants == "open" and not self._stuck

    def command(self) -> Command:
        """Look, and what is commanded at this sample. Call it once a sample."""
        self.look()
        override = any(item.wants == "override" for item in self.fresh)
        return Command(self.opening, override, self.link)

    def look(self) -> None:
        """Take what came. Call it once a sample."""
        now_ns = self._now_ns()
        if self._looked_ns is None or now_ns - self._looked_ns > EXPIRES_NS:
            # what waited since then has no known time
            self._stream.forget()
            self._opened_ns = now_ns

        self._looked_ns = now_ns
        self.fresh = [self._taken(item) for item in self._stream.came()]
        if self.fresh:
            self.newest = self.fresh[-1]
        if self.link == "live" and now_ns - self.newest.t_ns > EXPIRES_NS:
            self._log("wearer: the stream is silent; what the wearer wants is unknown")
            self.link = "expired"
            self.newest = Intent(now_ns, "unknown")
            self.fresh.append(self.newest)
        self._watch_opening(now_ns)

    def _watch_opening(self, now_ns: int) -> None:
        """How long it has been open; an opening that ended between two samples begins anew."""
        if any(item.wants != "open" for item in (*self.fresh, self.newest)):
            self._opened_ns = now_ns
            self._stuck = False
        elif not self._stuck and now_ns - self._opened_ns > MOST_OPEN_NS:
            self._log("wearer: open for 3 s; it does not count until it ends")
            self._stuck = True

    def _taken(self, item: Intent) -> Intent:
        if self.link == "expired":
            self._log("wearer: the stream is back")
        self.link = "live"
        return item


def intent_of(wants: object, t_ns: int) -> Intent:
    """An item. Raises ValueError."""
    for word in WORDS:
        if wants == word:
            return Intent(t_ns, word)
    if wants == OLDER_STOP:
        return Intent(t_ns, "stop")
    raise ValueError(f"wants is one of {', '.join(WORDS)}")


# -- the file of a trial

HEAD = ("Time (s)", "host (ns)", "wants")
INTENT_HEADER = ",".join(HEAD)
"""The first line, without its line end."""


def intent_row(item: Intent, first_ns: int, host_after_ns: int) -> str:
    """A line. first_ns: of the first sample. host_after_ns: the host's clock minus the run's."""
    time_s = f"{1e-9 * (item.t_ns - first_ns):.6f}"
    host_ns = str(item.t_ns + host_after_ns)
    return ",".join([time_s, host_ns, item.wants])


@dataclass(frozen=True)
class IntentRecord:
    """A file that was read: items with t_ns on the host's clock, and their times from the trial's
    first sample, s."""

    time_s: tuple[float, ...]
    items: tuple[Intent, ...]


def read_intent(path: Path) -> IntentRecord:
    """Read a file. Raises ColumnError, NotANumber, OSError."""
    lines = text_of(path).split("\n")
    # what follows the last line end is torn, or empty
    header = lines[0].split(",") if len(lines) > 1 else []
    if tuple(header[: len(HEAD)]) != HEAD:
        raise ColumnError(
            "not the columns of a wearer's command",
            where=path,
            cause="another file, or an edited one",
            next_step=f"its header begins with {INTENT_HEADER}",
        )

    times = []
    items = []
    for number, line in enumerate(lines[1:-1], start=2):
        try:
            time_s, item = _item_of_line(line.split(","), len(header))
        except ValueError as error:
            raise NotANumber(
                f"line {number}: {error}",
                where=path,
                next_step="correct or remove the line",
            ) from None

        times.append(time_s)
        items.append(item)

    return IntentRecord(tuple(times), tuple(items))


def _item_of_line(cells: list[str], n_columns: int) -> tuple[float, Intent]:
    """Time from the first sample, s, and the item of a line. Raises ValueError."""
    if len(cells) != n_columns:
        raise ValueError(f"{len(cells)} cells, not {n_columns}")
    time_s, host_ns, wants = cells[: len(HEAD)]
    wants = "stop" if wants == OLDER_STOP else wants
    if wants not in IN_FILE:
        raise ValueError(f"wants is {wants[:40]!r}")
    word = IN_FILE[IN_FILE.index(wants)]
    return float(time_s), Intent(int(host_ns), word)
