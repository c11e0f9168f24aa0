"""Commands of the user's own control, as datagrams: {"opening": true}, {"override": true}.

opening lasts until a datagram takes it back, or until no datagram has come for EXPIRES_NS. So a
sender repeats its command, or sends {} to show that it is still there. override counts for the
sample at which it came; the decision (edge_runtime/decision.py) sets how long it then lasts. At
most MOST_A_SAMPLE datagrams are read at one sample: a flooded port delays commands, but no sample.
Commands have a log of their own.

The wearer's own command beside the sensors: the stream behind the URL of --intent.

udp://HOST:PORT?envelopes=2 or lsl://NAME

The wearer's own command beside the samples of `holdfast run --samples FILE`: FILE.intent.csv.
"""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from pathlib import Path
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from holdfast.core.contract import CommandLink
from holdfast.core.errors import UsageError
from holdfast.core.trial_layout import intent_path
from holdfast.edge_runtime.commands import Command, receiving
from holdfast.edge_runtime.intent import (
    IntentMonitor,
    UdpIntent,
    intent_header,
    intent_row,
)
from holdfast.live.log_sink import Sink
from holdfast.live.outputs import file_sink


class IntentLog:
    """Writes what came at each sample."""

    def __init__(
        self, sink: Sink, intent: IntentMonitor, now_ns: Callable[[], int]
    ) -> None:
        self.sink, self._intent, self._now_ns = sink, intent, now_ns

    def write(self, first_ns: int | None) -> int:
        """The items of one sample; returns how many lines were dropped.

        first_ns: time of the first sample.
        """
        if not self._intent.fresh or first_ns is None or self.sink.failure is not None:
            return 0
        after_ns, count = time.monotonic_ns() - self._now_ns(), self._intent.n_envelopes
        rows = [
            intent_row(one, first_ns, after_ns, count) for one in self._intent.fresh
        ]
        return sum(not self.sink(row) for row in rows)


@contextmanager
def intent_log(
    samples: Path, intent: IntentMonitor, now_ns: Callable[[], int]
) -> Iterator[IntentLog]:
    """A new file beside the samples. now_ns: the run's clock. Raises OutputError."""
    header = intent_header(intent.n_envelopes)
    with file_sink(intent_path(samples), "--intent", header) as sink:
        yield IntentLog(sink, intent, now_ns)


ADDRESSES = "udp://127.0.0.1:9003?envelopes=2 or lsl://NAME"
MOST_ENVELOPES = 16
Say = Callable[[str], None]


@contextmanager
def intent_monitor(
    url: str | None, clock: Any, say: Say, opens_at: float | None = None
) -> Iterator[IntentMonitor | None]:
    """The stream of --intent, opened; None without it.

    Raises UsageError, DeviceNotFound, LibraryMissing.
    """
    if url is None:
        yield None
    elif url.startswith("lsl://"):
        from holdfast.drivers.lsl import LslIntent
        from holdfast.drivers.lsl_library import LslInlet

        with closing(LslInlet(_name(url))) as inlet:
            yield IntentMonitor(
                LslIntent(inlet, clock.now_ns, say), clock.now_ns, say, opens_at
            )
    else:
        address, n_envelopes = _udp(url)
        with receiving(address) as receiver:
            stream = UdpIntent(receiver, n_envelopes, clock.now_ns, say)
            yield IntentMonitor(stream, clock.now_ns, say, opens_at)


def _name(url: str) -> str:
    name = unquote(url.removeprefix("lsl://"))
    if not name or "'" in name:
        raise UsageError(
            f"--intent {url[:80]!r}: no name of a stream", next_step="lsl://NAME"
        )
    return name


def _udp(url: str) -> tuple[str, int]:
    """(HOST:PORT, number of envelopes)."""
    not_an_address = UsageError(
        f"--intent {url[:80]!r} is not an address", next_step=ADDRESSES
    )
    try:
        parts = urlsplit(url)
    except ValueError:
        raise not_an_address from None
    options = parse_qs(parts.query, keep_blank_values=True)
    count = options.pop("envelopes", ["2"])[-1]
    if parts.scheme != "udp" or parts.path or options:
        raise not_an_address
    if not count.isdecimal() or len(count) > 2 or not 1 <= int(count) <= MOST_ENVELOPES:
        raise UsageError(
            f"--intent: envelopes={count[:40]!r} is not a whole number from 1 to {MOST_ENVELOPES}",
            next_step="envelopes=2",
        )
    return parts.netloc, int(count)


def intended(
    command: Callable[[], Command], intent: IntentMonitor, *, obeyed: bool
) -> Callable[[], Command]:
    """A command that also looks at the stream, once a sample, and adds what it says if obeyed."""

    def ask() -> Command:
        intent.look()
        own = command()
        if not obeyed:
            return own
        return replace(
            own,
            opening=own.opening or intent.opening,
            link=_worse(own.link, intent.link),
        )

    return ask


def _worse(one: CommandLink, other: CommandLink) -> CommandLink:
    """An expired sender is never hidden by another that is live."""
    order: tuple[CommandLink, ...] = ("expired", "live", "none")
    return min(one, other, key=order.index)
