"""Where predictions go: a text stream, a file, a UDP port; one JSON line each.

Nobody is waited for. Who does not take a line in time (a full pipe, a stopped terminal, a full socket) misses
it, whole: the next one is newer. Whoever calls a sink counts what it did not take.
"""

from __future__ import annotations

import io
import select
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from edge_runtime.contract import Prediction
from edge_runtime.errors import OutputError, UsageError
from edge_runtime.output import to_json_line

Sink = Callable[[str], bool]
"""Hands a line on; whether it was taken."""


def stream_sink(stream: TextIO) -> Sink:
    """Every line at once: a controller that reads the pipe must not wait for a buffer.

    A pipe that can be written to takes 4096 bytes without waiting, more than a line has, and takes them in one piece.
    """
    ready = _readiness(stream)

    def write(line: str) -> bool:
        if not ready():
            return False
        stream.write(line + "\n")
        stream.flush()
        return True

    return write


def _readiness(stream: TextIO) -> Callable[[], bool]:
    """Whether a write would not wait; always true of what is no file of the system's."""
    poll = select.poll()
    try:
        poll.register(stream.fileno(), select.POLLOUT)
    except (io.UnsupportedOperation, AttributeError, ValueError):
        return lambda: True
    return lambda: bool(poll.poll(0))


@contextmanager
def file_sink(path: Path) -> Iterator[Sink]:
    """A new file, line-buffered. Raises OutputError where there is one already, or none can be made."""
    try:
        file = path.open("x", encoding="utf-8", buffering=1)
    except OSError as error:
        raise OutputError(f"cannot write ({error.strerror})", where=path, next_step="name a new file") from None
    with file:
        yield stream_sink(file)


@contextmanager
def udp_sink(address: str) -> Iterator[Sink]:
    """A datagram a line to HOST:PORT. Nobody listening is no error: the hand goes on. Raises UsageError."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError(f"{address!r} is no address", next_step="HOST:PORT, such as 127.0.0.1:9000")
    try:
        family, kind, proto, _, target = socket.getaddrinfo(host, int(port), type=socket.SOCK_DGRAM)[0]
    except OSError as error:
        raise UsageError(f"{address!r}: {error.strerror}", next_step="HOST:PORT, such as 127.0.0.1:9000") from None
    with socket.socket(family, kind, proto) as sender:
        sender.setblocking(False)

        def send(line: str) -> bool:
            try:
                sender.sendto(line.encode(), target)
            except OSError:  # a full buffer or a closed port
                return False
            return True

        yield send


def emit_to(sinks: Sequence[Sink]) -> Callable[[Prediction], int]:
    """One prediction to all of them; how many did not take it."""

    def emit(prediction: Prediction) -> int:
        line = to_json_line(prediction)
        return sum([not sink(line) for sink in sinks])

    return emit
