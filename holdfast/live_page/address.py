"""Where the live page listens: [HOST:]PORT, its socket, the URL that people open, and its token.

On a loopback host (the default) the page has no token; its server answers only requests that name a
loopback host, so no other web site can reach it by a name that it points here. On any other host
each path begins with a token, a secret of 128 bits that is drawn anew for every run.
"""

from __future__ import annotations

import errno
import secrets
import socket
from dataclasses import dataclass
from ipaddress import ip_address

from holdfast.edge_runtime.errors import UsageError
from holdfast.edge_runtime.reading import Json

LOOPBACK = "127.0.0.1"
LOOPBACK_NAMES = ("localhost", LOOPBACK, "::1")
TOKEN_BYTES = 16
WAITING_CONNECTIONS = 64
SEND_BUFFER = 32 << 10
"""Bytes that wait for a slow browser: a second or two of frames, so that it never shows old ones
for long."""
ELSEWHERE = ("192.0.2.1", 9)
"""An address for examples: a datagram socket that is connected to it sends nothing."""
EXAMPLES = "--web 8000 (this machine only), or --web 0.0.0.0:8000 (the network, with a token)"


@dataclass(frozen=True)
class PageAddress:
    """A listening socket, the URL to open, and who may ask. token: empty on loopback hosts.

    hosts: names that a request may ask for, where there is no token.
    """

    listener: socket.socket
    url: str
    token: str
    hosts: tuple[str, ...]

    def access(self) -> Json:
        """For the server (holdfast/live_page/server.py)."""
        return {"token": self.token, "hosts": list(self.hosts)}


def read_address(text: str) -> tuple[str, int]:
    """(host, port) of [HOST:]PORT. Raises UsageError.

    >>> read_address("8000"), read_address("[::1]:0")
    (('127.0.0.1', 8000), ('::1', 0))
    """
    host, colon, port = text.rpartition(":")
    bracketed = host.startswith("[") and host.endswith("]")
    host = host[1:-1] if bracketed else host
    wrong = (colon and not host) or (":" in host and not bracketed) or not host.isprintable()
    if wrong or not (port.isascii() and port.isdecimal()) or len(port) > 5 or int(port) > 65535:
        raise UsageError(f"--web {text[:80]!r} is not [HOST:]PORT", next_step=EXAMPLES)
    return host or LOOPBACK, int(port)


def listen(text: str) -> PageAddress:
    """Listen on [HOST:]PORT; port 0: any free one.

    Raises UsageError where the host is unknown or the port cannot be had.
    """
    host, port = read_address(text)
    try:
        found = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
    except (OSError, UnicodeError) as error:
        cause = getattr(error, "strerror", None) or str(error)
        raise UsageError(f"--web: no host {host!r}", cause=cause, next_step=EXAMPLES) from None
    listener = socket.socket(*found[:3])
    try:
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BUFFER)
        listener.bind(found[4])
        listener.listen(WAITING_CONNECTIONS)
    except OSError as error:
        listener.close()
        raise _cannot_listen(text, error) from None
    return _reached(listener, host)


def _cannot_listen(text: str, error: OSError) -> UsageError:
    causes = {
        errno.EADDRINUSE: "another run or program listens there",
        errno.EACCES: "a port below 1024 needs root",
        errno.EADDRNOTAVAIL: "this machine does not have that address",
    }
    return UsageError(
        f"--web {text[:80]!r}: {(error.strerror or str(error)).lower()}",
        cause=causes.get(error.errno or 0, ""),
        next_step="choose another port, such as --web 8001, or --web 0 for any free one",
    )


def _reached(listener: socket.socket, host: str) -> PageAddress:
    """How a listening socket is reached from a browser."""
    address, port = listener.getsockname()[:2]
    bound = ip_address(address.partition("%")[0])
    if bound.is_loopback:
        names = dict.fromkeys([*LOOPBACK_NAMES, host.lower(), str(bound)])
        return PageAddress(listener, f"http://{_in_url(host)}:{port}/", "", tuple(names))
    token = secrets.token_urlsafe(TOKEN_BYTES)
    shown = _own_address() if bound.is_unspecified else host
    return PageAddress(listener, f"http://{_in_url(shown)}:{port}/{token}/", token, ())


def _in_url(host: str) -> str:
    return f"[{host}]" if ":" in host else host


def _own_address() -> str:
    """The address by which others reach this machine; its name where it has no network."""
    try:
        with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
            probe.connect(ELSEWHERE)
            return str(probe.getsockname()[0])
    except OSError:
        return socket.gethostname()
