"""The wearer's own command beside the sensors: the stream behind the URL of --intent.

udp://HOST:PORT?envelopes=2 or lsl://NAME
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import closing, contextmanager
from dataclasses import replace
from typing import Any
from urllib.parse import parse_qs, unquote, urlsplit

from holdfast.edge_runtime.commands import receiving
from holdfast.edge_runtime.contract import CommandLink
from holdfast.edge_runtime.errors import UsageError
from holdfast.edge_runtime.intent import IntentMonitor, UdpIntent
from holdfast.edge_runtime.live import Command
from holdfast.intent_options import ADDRESSES

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
        from holdfast.drivers.lsl_intent import LslIntent
        from holdfast.drivers.lsl_library import LslInlet

        with closing(LslInlet(_name(url))) as inlet:
            yield IntentMonitor(LslIntent(inlet, clock.now_ns, say), clock.now_ns, say, opens_at)
    else:
        address, n_envelopes = _udp(url)
        with receiving(address) as receiver:
            stream = UdpIntent(receiver, n_envelopes, clock.now_ns, say)
            yield IntentMonitor(stream, clock.now_ns, say, opens_at)


def _name(url: str) -> str:
    name = unquote(url.removeprefix("lsl://"))
    if not name or "'" in name:
        raise UsageError(f"--intent {url[:80]!r}: no name of a stream", next_step="lsl://NAME")
    return name


def _udp(url: str) -> tuple[str, int]:
    """(HOST:PORT, number of envelopes)."""
    not_an_address = UsageError(f"--intent {url[:80]!r} is not an address", next_step=ADDRESSES)
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
            own, opening=own.opening or intent.opening, link=_worse(own.link, intent.link)
        )

    return ask


def _worse(one: CommandLink, other: CommandLink) -> CommandLink:
    """An expired sender is never hidden by another that is live."""
    order: tuple[CommandLink, ...] = ("expired", "live", "none")
    return min(one, other, key=order.index)
