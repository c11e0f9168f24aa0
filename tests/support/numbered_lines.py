"""A sender as it should be: its lines have a rising sequence."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import count
from typing import Any


class NumberedSender:
    """Sends lines to a socket file."""

    def __init__(self, path: str) -> None:
        self.socket = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._path = path
        self._numbers = count()

    def send(self, what: Any) -> None:
        """Send an object with its sequence; anything else, such as rubbish, as it is."""
        if isinstance(what, dict):
            what = {"sequence": next(self._numbers)} | what
        line = what if isinstance(what, bytes) else json.dumps(what).encode()
        self.socket.sendto(line, self._path)


@contextmanager
def numbered_sender(path: object) -> Iterator[NumberedSender]:
    """A sender, closed at the end."""
    sender = NumberedSender(str(path))
    with sender.socket:
        yield sender
