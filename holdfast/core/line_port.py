"""A port that lines come to, a datagram each, read without waiting.

    udp://HOST:PORT?key=FILE      a shared key is recommended on any network (line_key.py)
    unix:///PATH?key=FILE         the default on one board: a socket file with permissions 0600, so
                                  that only processes of the same user may write to it

At most MOST_A_CALL datagrams are read at a call, so a flooded port delays lines, but no sample. On
UDP the sender whose line was obeyed last has a queue of its own: its lines also arrive while others
flood the port. What is skipped is counted, and reported once a second.
"""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any, TypeVar
from urllib.parse import SplitResult, parse_qs, unquote, urlsplit

from holdfast.core.errors import UsageError
from holdfast.core.line_key import LinkKey, read_key
from holdfast.core.line_session import (
    LONGEST_LINE,
    LineReceiver,
    LineRefused,
    store_in_thread,
)
from holdfast.core.reading import Json
from holdfast.core.tally import Tally

MOST_A_CALL = 32
MOST_FORGOTTEN = 100_000
MOST_AHEAD = 1000
"""A second of lines of a fast sender of commands or envelopes."""
LONGEST_SHOWN = 80

T = TypeVar("T")


@dataclass(frozen=True)
class LineUrl:
    """Where lines go or come from. options: what stands behind the ?, without the key."""

    url: str
    parts: SplitResult
    options: dict[str, str]
    key: LinkKey | None

    @property
    def path(self) -> str:
        """Of a Unix socket or a serial port."""
        return unquote(self.parts.path)


def line_url(url: str, link: str) -> LineUrl:
    """The parts of a URL. link: the link that its key is for.

    Raises ValueError, and for a key UsageError, DataNotFound, AccessDenied.
    """
    parts = urlsplit(url)
    # looked at here: a port that is no number raises only when it is asked for
    _ = parts.port
    found = parse_qs(parts.query, keep_blank_values=True)
    options = {name: values[-1] for name, values in found.items()}
    path = options.pop("key", None)
    return LineUrl(
        url, parts, options, None if path is None else read_key(Path(path), link)
    )


def printable(datagram: bytes) -> str:
    """The beginning of a datagram as text without control characters."""
    text = datagram[: 4 * LONGEST_SHOWN].decode(errors="replace")[:LONGEST_SHOWN]
    return "".join(letter if letter.isprintable() else "?" for letter in text)


class Datagrams:
    """The datagrams that come to one open socket, those of one sender first."""

    def __init__(self, listener: socket.socket) -> None:
        self._listener = listener
        self._peer: socket.socket | None = None
        self._peer_address: Any = None

    @property
    def sockets(self) -> list[socket.socket]:
        """Those that datagrams come to: of the followed sender, and of all others."""
        return [one for one in (self._peer, self._listener) if one is not None]

    def waiting(self) -> Iterator[tuple[bytes, Any]]:
        """Datagrams that have come, with the sender's address; never waits."""
        for open_socket in self.sockets:
            for _ in range(MOST_A_CALL):
                try:
                    datagram, address = open_socket.recvfrom(LONGEST_LINE + 1)
                # a sender that is gone is reported at its own queue
                except (BlockingIOError, ConnectionError):
                    break
                yield datagram, address

    def forget(self) -> None:
        """Drop what is waiting."""
        for _ in range(MOST_FORGOTTEN):
            if not list(self.waiting()):
                return

    def follow(self, address: Any) -> None:
        """Give a sender a queue of its own: a connected socket at the same port."""
        if self._listener.family == socket.AF_UNIX or address == self._peer_address:
            return
        peer = socket.socket(self._listener.family, socket.SOCK_DGRAM)
        try:
            peer.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
            peer.bind(self._listener.getsockname())
            peer.connect(address)
            peer.setblocking(False)
        # without it the lines still come, to the shared queue
        except OSError:
            peer.close()
            return
        if self._peer is not None:
            self._peer.close()
        self._peer = peer
        self._peer_address = address

    def address(self) -> Any:
        """Of the listener."""
        return self._listener.getsockname()

    def close(self) -> None:
        """Close the queue of the sender that was followed."""
        if self._peer is not None:
            self._peer.close()
            self._peer = None


class LinePort(Datagrams):
    """The lines that come to one open socket, read by the rules of a receiver."""

    def __init__(
        self,
        listener: socket.socket,
        receiver: LineReceiver,
        tally: Tally,
    ) -> None:
        super().__init__(listener)
        self._receiver = receiver
        self._tally = tally

    def came(self, read: Callable[[Json], T]) -> list[tuple[T, bytes]]:
        """What `read` makes of each line that is obeyed, oldest first, and the line; never waits.

        read: raises ValueError, with the reason, for what it does not understand.
        """
        obeyed = []
        for datagram, address in self.waiting():
            try:
                value = self._receiver.take(datagram, read)
            except LineRefused as error:
                shown = f"{printable(datagram)} is skipped: {error}"
                self._tally.count(error.kind, shown)
                continue
            obeyed.append((value, datagram))
            self.follow(address)
        self._tally.look()
        return obeyed

    def close(self) -> None:
        """Report the last counts, and close the queue of the sender that was followed."""
        self._tally.flush()
        super().close()


@contextmanager
def line_port(
    url: str,
    link: str,
    report: Callable[[str], object],
    now_ns: Callable[[], int],
    options: dict[str, str] | None = None,
) -> Iterator[LinePort]:
    """Listen at udp://HOST:PORT or unix:///PATH. link: what its lines are, such as "commands".

    options: receives what else stands behind the ? in the URL; without it nothing may. Raises
    UsageError, and for a key DataNotFound and AccessDenied.
    """
    try:
        where = line_url(url, link)
    except ValueError as error:
        raise not_an_address(url, link, str(error)) from None
    if options is not None:
        options.update(where.options)
    elif where.options:
        raise not_an_address(url, link, f"{next(iter(where.options))} is not known")

    with ExitStack() as stack:
        listener = listening(where, link, stack)
        # a sample never waits for a line
        listener.setblocking(False)
        key = where.key
        receiver = LineReceiver(
            now_ns,
            MOST_AHEAD,
            key=key,
            # the permissions of a socket file say who may write
            needs_session=where.parts.scheme != "unix",
            began=None if key is None else store_in_thread(key, report),
        )
        port = LinePort(listener, receiver, Tally(link, report, now_ns))
        stack.callback(port.close)
        yield port


def not_an_address(url: str, link: str, cause: str = "") -> UsageError:
    """The error for a URL that is not of a port."""
    return UsageError(
        f"{link}: {url[:80]!r} is not an address",
        cause=cause,
        next_step=f"udp://127.0.0.1:9001 or unix:///run/holdfast/{link}",
    )


def listening(where: LineUrl, link: str, stack: ExitStack) -> socket.socket:
    """A socket that datagrams come to, closed with the stack. Raises UsageError."""
    try:
        if where.parts.scheme == "udp" and not where.parts.path:
            return _udp_listener(where, link, stack)
        if where.parts.scheme == "unix" and not where.parts.netloc and where.path:
            return _unix_listener(Path(where.path), stack)
    except (OSError, OverflowError, ValueError) as error:
        what = (error.strerror if isinstance(error, OSError) else "") or str(error)
        raise UsageError(
            f"{link}: cannot listen at {where.url[:80]!r}: {what}",
            next_step="choose another port or path",
        ) from None
    raise not_an_address(where.url, link)


def _udp_listener(where: LineUrl, link: str, stack: ExitStack) -> socket.socket:
    host, port = where.parts.hostname, where.parts.port
    if not host or port is None:
        raise not_an_address(where.url, link, "host or port is missing")
    listener = stack.enter_context(socket.socket(socket.AF_INET, socket.SOCK_DGRAM))
    listener.bind((host, port))
    # after bind, so that two programs never share a port: only for the queue of one sender
    listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEPORT, 1)
    return listener


def _unix_listener(path: Path, stack: ExitStack) -> socket.socket:
    listener = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    _remove_left_behind(path)
    # before bind: the file never has wider permissions than these, whatever the umask
    os.fchmod(listener.fileno(), stat.S_IRUSR | stat.S_IWUSR)
    listener.bind(str(path))
    stack.callback(path.unlink, missing_ok=True)
    return listener


def _remove_left_behind(path: Path) -> None:
    """Remove the socket file of a program that ended; leave anything else. Raises OSError."""
    with suppress(FileNotFoundError):
        if not stat.S_ISSOCK(path.lstat().st_mode):
            return
        with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as probe:
            try:
                probe.connect(str(path))
            except ConnectionRefusedError:
                path.unlink()
