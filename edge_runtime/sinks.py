"""Where predictions go: a text stream, a file, a UDP port; one JSON line each.

The loop never waits for a sink. Streams and files are logs: a thread of their own writes them
(line_writer.py), what they do not take in time is dropped whole and counted, and a log that fails
is left out, told and counted, while the loop goes on. A UDP port is written by the loop itself,
which a socket never delays; a controller may listen there, so it counts as acting. Only the loss of
every acting sink leaves a run without a purpose.
"""

from __future__ import annotations

import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from edge_runtime.contract import Prediction
from edge_runtime.errors import OutputError, UsageError
from edge_runtime.line_writer import CLOSING_S
from edge_runtime.log_sink import Kind, LogSink
from edge_runtime.log_sink import Sink as Sink
from edge_runtime.log_sink import stream_sink as stream_sink
from edge_runtime.output import to_json_line


class UdpSink:
    """A datagram a line. A port where no program listens is no failure: a controller may start
    later."""

    kind: Kind = "acting"
    failure: OSError | None = None

    def __init__(self, sender: socket.socket, target: tuple[object, ...], name: str) -> None:
        self.name = name
        self.dropped = 0
        self._sender, self._target = sender, target

    def __call__(self, line: str) -> bool:
        """Send it; False where the system does not take it now: a full buffer, a network that is
        down."""
        try:
            self._sender.sendto(line.encode(), self._target)
        except OSError:
            self.dropped += 1
            return False
        return True

    def end(self) -> None:
        """Nothing is under way."""

    def close(self, wait_s: float = CLOSING_S) -> None:
        """Nothing is under way."""


@contextmanager
def file_sink(path: Path, name: str = "", header: str | None = None) -> Iterator[Sink]:
    """A new file, a line at a time, after its header. Raises OutputError where it exists or cannot
    be made."""
    try:
        handle = os.open(path, os.O_WRONLY | os.O_CREAT | os.O_EXCL, 0o666)
    except OSError as error:
        raise OutputError(
            f"cannot write ({error.strerror})", where=path, next_step="name a new file"
        ) from None
    sink = LogSink(handle, f"{name} {path}".strip(), header)
    try:
        yield sink
    finally:
        sink.close()


@contextmanager
def udp_sink(address: str) -> Iterator[Sink]:
    """A datagram a line to HOST:PORT. Raises UsageError."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError(
            f"{address!r} is no address", next_step="HOST:PORT, such as 127.0.0.1:9000"
        )
    try:
        family, kind, proto, _, target = socket.getaddrinfo(
            host, int(port), type=socket.SOCK_DGRAM
        )[0]
    except OSError as error:
        raise UsageError(
            f"{address!r}: {error.strerror}", next_step="HOST:PORT, such as 127.0.0.1:9000"
        ) from None
    with socket.socket(family, kind, proto) as sender:
        sender.setblocking(False)
        yield UdpSink(sender, target, f"--udp {address}")


class Outlets:
    """All sinks of a run: hands each prediction to every living one, and notices those that fail.

    sinks: take predictions. others: take other lines (samples), are closed with them. watched: only
    noticed. tell: says on stderr what fails. failures: the error by the sink's name.
    """

    def __init__(
        self,
        sinks: Sequence[Sink],
        tell: Callable[[str], object],
        *,
        others: Sequence[Sink] = (),
        watched: Sequence[Sink] = (),
    ) -> None:
        self.failures: dict[str, OSError] = {}
        self._sinks, self._tell = list(sinks), tell
        self._all = [*sinks, *others]
        self._living = [*self._all, *watched]
        self._acting = [sink for sink in sinks if sink.kind == "acting"]

    @property
    def dropped(self) -> int:
        """Lines that were offered to sinks and others and are not in them; exact after `close`."""
        return sum(sink.dropped for sink in self._all)

    def lost(self) -> dict[str, str]:
        """Why a sink failed, in words, by its name."""
        return {name: str(error.strerror or error) for name, error in self.failures.items()}

    def emit(self, prediction: Prediction) -> int:
        """Hand it to all sinks that live; how many dropped a line."""
        line = to_json_line(prediction)
        dropped = sum([not sink(line) for sink in self._sinks])
        self.look()
        return dropped

    def look(self) -> None:
        """Leave out each sink that has failed since, and tell so once."""
        for sink in self._living:
            if sink.failure is not None:
                self._leave_out(sink, sink.failure)

    def _leave_out(self, sink: Sink, why: OSError) -> None:
        self._living = [one for one in self._living if one is not sink]
        self._sinks = [one for one in self._sinks if one is not sink]
        self.failures[sink.name] = why
        self._tell(
            f"{sink.name} takes no more lines ({self.lost()[sink.name]}); it is dropped, control goes on"
        )

    def none_acts(self) -> bool:
        """Whether there were acting sinks and all are lost: no answer can reach a hand any more."""
        return bool(self._acting) and all(sink.failure is not None for sink in self._acting)

    def close(self, wait_s: float = CLOSING_S) -> None:
        """End all at once, and wait at most wait_s for all of them together; then notice what
        failed at the end."""
        for sink in self._all:
            sink.end()
        end_s = time.monotonic() + wait_s
        for sink in self._all:
            sink.close(end_s - time.monotonic())
        self.look()
