"""The wearer's own command as a stream beside the sensors: EMG envelopes, or words.

    {"envelope": [0.62, 0.08]}          0 to 1 each; the first is that of the muscle that opens
    {"wants": "open"}                   or "close", "rest"

Nothing that a stream says reaches the decision, unless the run was asked for it. A stream that has
been silent for EXPIRES_NS means `unknown`, never that the hand should close. A word counts before
envelopes. Without words, and with a level, the wearer wants to open from the moment when the first
envelope reaches the level until it is below half of it.

The wearer's own command beside a trial: trial_n.intent.csv, tactile.intent.csv.

    Time (s),host (ns),wants,envelope 1 (0 to 1),envelope 2 (0 to 1)

Time counts from the trial's first sample; host is CLOCK_MONOTONIC, as in tactile.csv. Where the
stream goes silent, a line says `unknown`. A torn last line, as a kill leaves it, is not read.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Literal, Protocol

from holdfast.core.contract import CommandLink
from holdfast.core.errors import ColumnError, NotANumber
from holdfast.core.reading import json_of, text_of
from holdfast.edge_runtime.commands import EXPIRES_NS, printable, waiting

Wants = Literal["open", "close", "rest", "unknown", ""]
"""What the wearer wants; "" where the stream has only envelopes and no level is given."""
WORDS: tuple[Wants, ...] = ("open", "close", "rest")
KEYS = {"envelope", "wants"}
ENDS_AT = 0.5
"""An opening ends below this share of the level at which it begins."""
MOST_FORGOTTEN = 100_000


@dataclass(frozen=True)
class Intent:
    """One item of a stream: its time on the run's clock, and what it says."""

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

    fresh: the items of the last sample, as they are recorded. say: receives a line when the stream
    goes silent and when it is back. opens_at: the level of the first envelope, None where envelopes
    are only shown.
    """

    def __init__(
        self,
        stream: IntentStream,
        now_ns: Callable[[], int],
        say: Callable[[str], object],
        opens_at: float | None = None,
    ) -> None:
        self._stream, self._now_ns, self._say, self._opens_at = (
            stream,
            now_ns,
            say,
            opens_at,
        )
        self._opening = False
        self._looked_ns: int | None = None
        self.n_envelopes = stream.n_envelopes
        self.link: CommandLink = "none"
        self.newest, self.fresh = Intent(0, "unknown"), list[Intent]()

    @property
    def opening(self) -> bool:
        """Whether the wearer wants to open the hand, as far as that is known."""
        return self.newest.wants == "open"

    def look(self) -> None:
        """Take what came. Call it once a sample."""
        now_ns = self._now_ns()
        if self._looked_ns is None or now_ns - self._looked_ns > EXPIRES_NS:
            self._stream.forget()  # what waited since then has no known time
        self._looked_ns = now_ns
        self.fresh = [self._taken(one) for one in self._stream.came()]
        if self.fresh:
            self.newest = self.fresh[-1]
        if self.link == "live" and now_ns - self.newest.t_ns > EXPIRES_NS:
            self._say("intent: the stream is silent; what the wearer wants is unknown")
            self._opening, self.link = False, "expired"
            self.newest = Intent(now_ns, "unknown")
            self.fresh.append(self.newest)

    def _taken(self, item: Intent) -> Intent:
        if self.link == "expired":
            self._say("intent: the stream is back")
        self.link = "live"
        if item.wants or self._opens_at is None or not item.envelope:
            self._opening = item.wants == "open"
            return item
        level = self._opens_at * (ENDS_AT if self._opening else 1.0)
        self._opening = item.envelope[0] >= level
        return replace(item, wants="open" if self._opening else "rest")


class ItemReader:
    """Reads items one by one. say: receives the first in a row that is not understood."""

    def __init__(self, say: Callable[[str], object]) -> None:
        self._say, self._understood = say, True

    def item(self, read: Callable[[], Intent], shown: str) -> Intent | None:
        """What `read` returns, None where it raises ValueError. shown: the item, for the line."""
        try:
            item = read()
        except ValueError as error:
            if self._understood:
                self._say(f"intent: {shown[:80]} is not understood ({error})")
            self._understood = False
            return None
        self._understood = True
        return item


class UdpIntent:
    """Items as datagrams, stamped at the sample at which they are read."""

    def __init__(
        self,
        receiver: socket.socket,
        n_envelopes: int,
        now_ns: Callable[[], int],
        say: Callable[[str], object],
    ) -> None:
        self._receiver, self.n_envelopes = receiver, n_envelopes
        self._now_ns, self._reader = now_ns, ItemReader(say)

    def came(self) -> list[Intent]:
        """What is waiting."""
        read = [self._item(datagram) for datagram in waiting(self._receiver)]
        return [one for one in read if one is not None]

    def forget(self) -> None:
        """Drop what is waiting."""
        for _ in range(MOST_FORGOTTEN):
            if not list(waiting(self._receiver)):
                return

    def _item(self, datagram: bytes) -> Intent | None:
        return self._reader.item(
            lambda: item_of(json_of(datagram), self._now_ns(), self.n_envelopes),
            printable(datagram),
        )


def item_of(said: object, t_ns: int, n_envelopes: int) -> Intent:
    """An item of a JSON object. Raises ValueError, with the reason."""
    if not isinstance(said, dict) or not said or not set(said) <= KEYS:
        raise ValueError('no {"envelope": [..]} or {"wants": ".."}')
    envelope = said.get("envelope", [])
    if "envelope" in said and not isinstance(envelope, list):
        raise ValueError("envelope is no list")
    return intent_of(said.get("wants", ""), envelope, t_ns, n_envelopes)


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
    return Intent(t_ns, wants, tuple(map(share, envelope)))


def share(value: object) -> float:
    """An envelope, 0 to 1. Raises ValueError."""
    if isinstance(value, bool) or not isinstance(value, int | float):
        raise ValueError("an envelope is no number")
    if not 0.0 <= value <= 1.0:
        raise ValueError("an envelope is not within 0 and 1")
    return float(value)


HEAD = ("Time (s)", "host (ns)", "wants")
ALLOWED: tuple[Wants, ...] = ("", "unknown", *WORDS)


def intent_header(n_envelopes: int) -> str:
    """The first line, without its line end."""
    return ",".join(
        [*HEAD, *(f"envelope {k} (0 to 1)" for k in range(1, n_envelopes + 1))]
    )


def intent_row(
    item: Intent, first_ns: int, host_after_ns: int, n_envelopes: int
) -> str:
    """A line. first_ns: time of the first sample. host_after_ns: the host's clock minus the run's.

    Without envelopes their cells are empty.
    """
    envelope = [repr(value) for value in item.envelope] or [""] * n_envelopes
    time_s = f"{1e-9 * (item.t_ns - first_ns):.6f}"
    return ",".join([time_s, str(item.t_ns + host_after_ns), item.wants, *envelope])


@dataclass(frozen=True)
class IntentRecord:
    """A file that was read: items with t_ns on the host's clock, and their times from the trial's
    first sample, s."""

    time_s: tuple[float, ...]
    items: tuple[Intent, ...]


def read_intent(path: Path) -> IntentRecord:
    """Read a file. Raises ColumnError, NotANumber, TooLarge, OSError."""
    try:
        header, *lines = text_of(path).split("\n")[:-1] or [""]
    except UnicodeDecodeError:
        header, lines = "", []
    n_envelopes = len(header.split(",")) - len(HEAD)
    if n_envelopes < 0 or header != intent_header(n_envelopes):
        raise ColumnError(
            "not the columns of a wearer's own command",
            where=path,
            cause="another file, or an edited one",
            next_step=f"its header begins with {','.join(HEAD)}",
        )
    times, items = [], []
    for number, line in enumerate(lines, start=2):
        try:
            time_s, item = _item(line.split(","), n_envelopes)
        except ValueError as error:
            raise NotANumber(
                f"line {number}: {error}",
                where=path,
                next_step="correct or remove the line",
            ) from None
        times.append(time_s)
        items.append(item)
    return IntentRecord(tuple(times), tuple(items))


def _item(cells: list[str], n_envelopes: int) -> tuple[float, Intent]:
    if len(cells) != len(HEAD) + n_envelopes:
        raise ValueError(f"{len(cells)} cells, not {len(HEAD) + n_envelopes}")
    time_s, host_ns, wants, *envelope = cells
    for word in ALLOWED:
        if wants == word:
            values = (
                tuple(share(float(cell)) for cell in envelope) if any(envelope) else ()
            )
            return float(time_s), Intent(int(host_ns), word, values)
    raise ValueError(f"wants is {wants[:40]!r}")
