"""The wearer's command as a stream next to the sensors: EMG envelopes, or words.

    {"envelope": [0.62, 0.08]}          0 to 1 each; the first is that of the muscle that opens
    {"wants": "open"}                   or "close", "rest"

Nothing in a stream reaches the decision, unless the run was asked for it. A stream that has been
silent for EXPIRES_NS means `unknown`, never that the hand should close. An opening that lasts for
MOST_OPEN_NS no longer counts until it has ended: an electrode that has come off reads like one. A
word counts before envelopes. Without words, and with a level, the wearer wants to open from the
moment when the first envelope reaches the level until it is below half of it.

The same as a file of a trial (trial_n.intent.csv, tactile.intent.csv):

    Time (s),host (ns),wants,envelope 1 (0 to 1),envelope 2 (0 to 1)

Time counts from the trial's first sample; host is CLOCK_MONOTONIC, as in tactile.csv. Where the
stream goes silent, a line has `unknown`. A torn last line, as a kill leaves it, is not read.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

from holdfast.core.contract import CommandLink
from holdfast.core.errors import ColumnError, NotANumber
from holdfast.core.line_port import LinePort
from holdfast.core.reading import Json, text_of
from holdfast.edge_runtime.commands import EXPIRES_NS

Wants = Literal["open", "close", "rest", "unknown", ""]
"""What the wearer wants; "" where the stream has only envelopes and no level is given."""
WORDS: tuple[Wants, ...] = ("open", "close", "rest")
KEYS = {"envelope", "wants"}
ENDS_AT = 0.5
"""An opening ends below this share of the level at which it begins."""
MOST_OPEN_NS = 3_000_000_000
"""A hand opens within half a second, and a receiver takes what it holds: longer, it is a fault."""
MOST_FORGOTTEN = 100_000


@dataclass(frozen=True)
class Intent:
    """One item of a stream, with its time on the run's clock."""

    t_ns: int
    wants: Wants
    envelope: tuple[float, ...] = ()


class IntentStream(Protocol):
    """Where items come from. n_envelopes: how many an item has, if any."""

    n_envelopes: int

    def came(self) -> list[Intent]:
        """What came since the last call, oldest first; never waits."""
        ...

    def forget(self) -> None:
        """Drop what came before now."""
        ...


class IntentMonitor:
    """Follows a stream. newest: the last item, `unknown` before the first and after a silence.

    fresh: the items of the last sample, as they are recorded. log: receives a line when the stream
    goes silent and when it is back. opens_at: the level of the first envelope, None where envelopes
    are only shown.
    """

    def __init__(
        self,
        stream: IntentStream,
        now_ns: Callable[[], int],
        log: Callable[[str], object],
        opens_at: float | None = None,
    ) -> None:
        self._stream = stream
        self._now_ns = now_ns
        self._log = log
        self._opens_at = opens_at
        self._opening = False
        self._opened_ns = 0
        self._stuck = False
        self._looked_ns: int | None = None
        self.n_envelopes = stream.n_envelopes
        self.link: CommandLink = "none"
        self.newest = Intent(0, "unknown")
        self.fresh: list[Intent] = []

    @property
    def opening(self) -> bool:
        """Whether the wearer wants to open the hand, as far as that is known and can be meant."""
        return self.newest.wants == "open" and not self._stuck

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
            self._log("intent: the stream is silent; what the wearer wants is unknown")
            self._opening = False
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
            self._log("intent: open for 3 s; it does not count until it ends")
            self._stuck = True

    def _taken(self, item: Intent) -> Intent:
        """The item, with a word where its first envelope says one."""
        if self.link == "expired":
            self._log("intent: the stream is back")

        self.link = "live"
        if item.wants or self._opens_at is None or not item.envelope:
            self._opening = item.wants == "open"
            return item

        # an opening ends at a lower level than it begins, so that noise does not end it
        level = self._opens_at
        if self._opening:
            level *= ENDS_AT
        self._opening = item.envelope[0] >= level

        return replace(item, wants="open" if self._opening else "rest")


class ItemReader:
    """Reads items one by one. log: receives the first in a row that is not understood."""

    def __init__(self, log: Callable[[str], object]) -> None:
        self._log = log
        self._understood = True

    def item(self, read: Callable[[], Intent], shown: str) -> Intent | None:
        """What `read` returns, None where it raises ValueError. shown: the item, for the line."""
        try:
            item = read()
        except ValueError as error:
            if self._understood:
                self._log(f"intent: {shown[:80]} is not understood ({error})")
            self._understood = False
            return None

        self._understood = True
        return item


class PortIntent:
    """Items as lines that come to a port, stamped at the sample at which they are read."""

    def __init__(
        self, port: LinePort, n_envelopes: int, now_ns: Callable[[], int]
    ) -> None:
        self._port = port
        self.n_envelopes = n_envelopes
        self._now_ns = now_ns

    def came(self) -> list[Intent]:
        """What is waiting, by the rules of the port."""
        return [item for item, _ in self._port.came(self._item)]

    def forget(self) -> None:
        """Drop what is waiting."""
        self._port.forget()

    def _item(self, keys: Json) -> Intent:
        """An item of a JSON object. Raises ValueError, with the reason."""
        if not keys or not set(keys) <= KEYS:
            raise ValueError('no {"envelope": [..]} or {"wants": ".."}')
        envelope = keys.get("envelope", [])
        if not isinstance(envelope, list):
            raise ValueError("envelope is no list")
        wants = keys.get("wants", "")
        return intent_of(wants, envelope, self._now_ns(), self.n_envelopes)


def intent_of(
    wants: object, envelope: Sequence[object], t_ns: int, n_envelopes: int
) -> Intent:
    """An item. wants: "" for none; envelope: empty for none. Raises ValueError."""
    if wants not in ("", *WORDS):
        raise ValueError(f"wants is one of {', '.join(WORDS)}")
    if envelope and len(envelope) != n_envelopes:
        raise ValueError(f"{len(envelope)} envelopes, not {n_envelopes}")
    if not wants and not envelope:
        raise ValueError("it is empty")
    return Intent(t_ns, wants, tuple(map(_share, envelope)))


def _share(value: object) -> float:
    """An envelope, 0 to 1. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("an envelope is no number")
    if not 0.0 <= value <= 1.0:
        raise ValueError("an envelope is not within 0 and 1")
    return float(value)


# -- the file of a trial

HEAD = ("Time (s)", "host (ns)", "wants")
IN_FILE: tuple[Wants, ...] = ("", "unknown", *WORDS)


def intent_header(n_envelopes: int) -> str:
    """The first line, without its line end."""
    names = [f"envelope {k} (0 to 1)" for k in range(1, n_envelopes + 1)]
    return ",".join([*HEAD, *names])


def intent_row(
    item: Intent, first_ns: int, host_after_ns: int, n_envelopes: int
) -> str:
    """A line. first_ns: time of the first sample. host_after_ns: the host's clock minus the run's.

    Without envelopes their cells are empty.
    """
    envelope = [repr(value) for value in item.envelope] or [""] * n_envelopes
    time_s = f"{1e-9 * (item.t_ns - first_ns):.6f}"
    host_ns = str(item.t_ns + host_after_ns)
    return ",".join([time_s, host_ns, item.wants, *envelope])


@dataclass(frozen=True)
class IntentRecord:
    """A file that was read: items with t_ns on the host's clock, and their times from the trial's
    first sample, s."""

    time_s: tuple[float, ...]
    items: tuple[Intent, ...]


def read_intent(path: Path) -> IntentRecord:
    """Read a file. Raises ColumnError, NotANumber, OSError."""
    try:
        lines = text_of(path).split("\n")
    except UnicodeDecodeError:
        lines = [""]

    # what follows the last line end is torn, or empty
    header = lines[0] if len(lines) > 1 else ""
    n_envelopes = len(header.split(",")) - len(HEAD)
    if n_envelopes < 0 or header != intent_header(n_envelopes):
        raise ColumnError(
            "not the columns of a wearer's command",
            where=path,
            cause="another file, or an edited one",
            next_step=f"its header begins with {','.join(HEAD)}",
        )

    times = []
    items = []
    for number, line in enumerate(lines[1:-1], start=2):
        try:
            time_s, item = _item_of_line(line.split(","), n_envelopes)
        except ValueError as error:
            raise NotANumber(
                f"line {number}: {error}",
                where=path,
                next_step="correct or remove the line",
            ) from None

        times.append(time_s)
        items.append(item)

    return IntentRecord(tuple(times), tuple(items))


def _item_of_line(cells: list[str], n_envelopes: int) -> tuple[float, Intent]:
    """Time from the first sample, s, and the item of a line. Raises ValueError."""
    if len(cells) != len(HEAD) + n_envelopes:
        raise ValueError(f"{len(cells)} cells, not {len(HEAD) + n_envelopes}")
    time_s, host_ns, wants, *envelope = cells
    if wants not in IN_FILE:
        raise ValueError(f"wants is {wants[:40]!r}")

    shares = []
    # a line with a word alone leaves all its envelopes empty
    if any(envelope):
        shares = [_share(float(cell)) for cell in envelope]
    word = IN_FILE[IN_FILE.index(wants)]
    return float(time_s), Intent(int(host_ns), word, tuple(shares))
