"""A sender as it should be: every line has its session and a rising sequence."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any

from holdfast.core.line_key import LinkKey


class NumberedSender:
    """Sends lines of one session to an address. session: of its lines."""

    def __init__(
        self, address: Any, session: int = 4127, key: LinkKey | None = None
    ) -> None:
        family = socket.AF_UNIX if isinstance(address, str) else socket.AF_INET
        self.socket = socket.socket(family, socket.SOCK_DGRAM)
        self.session = session
        self._address = address
        self._key = key
        self._numbers = count()

    def send(self, what: Any) -> None:
        """Send an object with its numbers; anything else, such as rubbish, as it is."""
        self.socket.sendto(self.line(what), self._address)

    def line(self, what: Any) -> bytes:
        """The line that `send` sends."""
        if isinstance(what, bytes):
            return what
        if isinstance(what, dict):
            numbers = {"session": self.session, "sequence": next(self._numbers)}
            what = numbers | what
        line = json.dumps(what).encode()
        return line if self._key is None else self._key.sealed(line)


@contextmanager
def numbered_sender(
    address: Any, session: int = 4127, key: LinkKey | None = None
) -> Iterator[NumberedSender]:
    """A sender, closed at the end."""
    sender = NumberedSender(address, session, key)
    with sender.socket:
        yield sender
