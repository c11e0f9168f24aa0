"""What the user's own control says, as datagrams: {"opening": true}, {"override": true}. A log of its own.

opening lasts until it is taken back; override holds for one sample, ends whatever is requested, and always wins.
At most MOST_A_SAMPLE datagrams are read at one sample: whoever floods the port delays commands, and no sample.
"""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import contextmanager

from edge_runtime.errors import UsageError
from edge_runtime.live import Command
from edge_runtime.reading import json_of

LONGEST = 1024
MOST_A_SAMPLE = 32
KEYS = {"opening", "override"}


@contextmanager
def command_port(address: str, log: Callable[[str], None]) -> Iterator[Callable[[], Command]]:
    """Listen on HOST:PORT; what it yields is asked once a sample and never waits. log: every command, one line.

    Raises UsageError where nobody can listen there.
    """
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal():
        raise UsageError(f"{address!r} is no address", next_step="HOST:PORT, such as 127.0.0.1:9001")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as receiver:
        try:
            receiver.bind((host, int(port)))
        except (OSError, OverflowError, ValueError) as error:
            raise UsageError(f"{address!r}: {error}", next_step="another port") from None
        receiver.setblocking(False)
        opening = False

        def ask() -> Command:
            nonlocal opening
            override = False
            for told in _waiting(receiver):
                command = _read(told)
                log(f"command: {_printable(told)}" + ("" if command else " (not understood)"))
                opening = command.get("opening", opening)
                override = override or command.get("override", False)
            return Command(opening, override)

        yield ask


def _waiting(receiver: socket.socket) -> Iterator[bytes]:
    for _ in range(MOST_A_SAMPLE):
        try:
            yield receiver.recv(LONGEST)
        except BlockingIOError:
            return


def _printable(told: bytes) -> str:
    """As text that leaves a terminal as it is."""
    return "".join(c if c.isprintable() else "?" for c in told.decode(errors="replace"))


def _read(told: bytes) -> dict[str, bool]:
    """The known keys with true or false; nothing where it is not understood."""
    try:
        found = json_of(told)
    except ValueError:
        return {}
    if not isinstance(found, dict) or not set(found) <= KEYS or not all(isinstance(v, bool) for v in found.values()):
        return {}
    return found
