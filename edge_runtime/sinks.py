"""Where predictions go: a text stream, a file, a UDP port; one JSON line each."""

from __future__ import annotations

import contextlib
import socket
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TextIO

from edge_runtime.contract import Prediction
from edge_runtime.errors import OutputError, UsageError
from edge_runtime.output import to_json_line

Sink = Callable[[str], None]


def stream_sink(stream: TextIO) -> Sink:
    """Every line at once: a controller that reads the pipe must not wait for a buffer."""

    def write(line: str) -> None:
        stream.write(line + "\n")
        stream.flush()

    return write


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

        def send(line: str) -> None:
            with contextlib.suppress(OSError):  # a full buffer or a closed port: the next line is newer
                sender.sendto(line.encode(), target)

        yield send


def emit_to(sinks: Sequence[Sink]) -> Callable[[Prediction], None]:
    """One prediction to all of them."""

    def emit(prediction: Prediction) -> None:
        line = to_json_line(prediction)
        for sink in sinks:
            sink(line)

    return emit
