"""Where predictions go: a text stream, a file, a UDP port; one JSON line each.

The loop never waits for a sink. Streams and files are logs: a thread of their own writes them
(line_writer.py). Lines that they do not take in time are dropped whole and counted. A log that
fails is left out, reported and counted, while the loop goes on. The loop itself writes to a UDP
port, because a socket never delays it. A controller may listen there, so a UDP port counts as
acting. A run ends without purpose only when every acting sink is lost.

Predictions as JSON lines: one object a sample, the output contract to the letter.

Prepared samples as a CSV that replays to the same decisions: Time, X1 .. Zn, valid1 .. validn.

All digits are kept.
"""

from __future__ import annotations

import json
import os
import socket
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict
from pathlib import Path

from holdfast.core.contract import Prediction, Sample, channel_names
from holdfast.core.errors import OutputError, UsageError
from holdfast.core.trial_file import TIME_COLUMN
from holdfast.live.line_writer import CLOSING_S
from holdfast.live.log_sink import Kind, LogSink, Sink


def to_json_line(prediction: Prediction) -> str:
    """One line without the line break; floats keep all their digits, unknown values are null."""
    return json.dumps(asdict(prediction), separators=(",", ":"), allow_nan=False)


class UdpSink:
    """One datagram for each line. A port without a listener is no failure.

    A controller may start later.
    """

    kind: Kind = "acting"
    failure: OSError | None = None

    def __init__(
        self, sender: socket.socket, target: tuple[object, ...], name: str
    ) -> None:
        self.name = name
        self.dropped = 0
        self._sender, self._target = sender, target

    def __call__(self, line: str) -> bool:
        """Send it; False where the system does not take it.

        A full buffer, a network that is down.
        """
        try:
            self._sender.sendto(line.encode(), self._target)
        except OSError:
            self.dropped += 1
            return False
        return True

    def end(self) -> None:
        """No line is waiting."""

    def close(self, wait_s: float = CLOSING_S) -> None:
        """No line is waiting."""


@contextmanager
def file_sink(path: Path, name: str = "", header: str | None = None) -> Iterator[Sink]:
    """A new file, a line at a time, after its header.

    Raises OutputError if it exists or is not writable.
    """
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
    """One datagram for each line to HOST:PORT. Raises UsageError."""
    host, _, port = address.rpartition(":")
    if not host or not port.isdecimal() or not 0 < int(port) < 65536:
        raise UsageError(
            f"{address!r} is not an address",
            next_step="give HOST:PORT, such as 127.0.0.1:9000",
        )
    try:
        family, kind, proto, _, target = socket.getaddrinfo(
            host, int(port), type=socket.SOCK_DGRAM
        )[0]
    except OSError as error:
        raise UsageError(
            f"{address!r}: {error.strerror}",
            next_step="give HOST:PORT, such as 127.0.0.1:9000",
        ) from None
    with socket.socket(family, kind, proto) as sender:
        sender.setblocking(False)
        yield UdpSink(sender, target, f"--udp {address}")


class Outlets:
    """All sinks of a run: passes each prediction to every working sink, and detects failures.

    sinks: take predictions. others: take other lines (samples), and are closed with them. watched:
    only checked for failures. say: receives a line for each failure. failures: the error by the
    sink's name.
    """

    def __init__(
        self,
        sinks: Sequence[Sink],
        say: Callable[[str], object],
        *,
        others: Sequence[Sink] = (),
        watched: Sequence[Sink] = (),
    ) -> None:
        self.failures: dict[str, OSError] = {}
        self._sinks, self._say = list(sinks), say
        self._all = [*sinks, *others]
        self._living = [*self._all, *watched]
        self._acting = [sink for sink in sinks if sink.kind == "acting"]

    @property
    def dropped(self) -> int:
        """Lines that were offered to sinks and others and are not in them; exact after `close`."""
        return sum(sink.dropped for sink in self._all)

    def lost(self) -> dict[str, str]:
        """The reason why a sink failed, by its name."""
        return {
            name: str(error.strerror or error) for name, error in self.failures.items()
        }

    def emit(self, prediction: Prediction) -> int:
        """Pass it to all working sinks; returns how many dropped a line."""
        line = to_json_line(prediction)
        dropped = sum([not sink(line) for sink in self._sinks])
        self.look()
        return dropped

    def look(self) -> None:
        """Leave out each sink that has failed since the last look, and report it once."""
        for sink in self._living:
            if sink.failure is not None:
                self._leave_out(sink, sink.failure)

    def _leave_out(self, sink: Sink, why: OSError) -> None:
        self._living = [one for one in self._living if one is not sink]
        self._sinks = [one for one in self._sinks if one is not sink]
        self.failures[sink.name] = why
        reason = self.lost()[sink.name]
        self._say(
            f"{sink.name} takes no more lines ({reason}); it is dropped, control goes on"
        )

    def add(self, sink: Sink) -> None:
        """Look after one more sink that gets its lines from elsewhere, and close it with them."""
        self._all.append(sink)
        self._living.append(sink)

    def none_acts(self) -> bool:
        """Whether there were acting sinks and all of them failed: no answer can reach a hand."""
        return bool(self._acting) and all(
            sink.failure is not None for sink in self._acting
        )

    def close(self, wait_s: float = CLOSING_S) -> None:
        """End all sinks at once and wait at most wait_s for all together.

        Report those that failed.
        """
        for sink in self._all:
            sink.end()
        end_s = time.monotonic() + wait_s
        for sink in self._all:
            sink.close(end_s - time.monotonic())
        self.look()


class SampleFile:
    """Writes samples to a sink; invalid values are written as they are, nan too.

    first_ns: time of the first sample, None before it.
    """

    def __init__(self, sink: Sink) -> None:
        self.sink = sink
        self.first_ns: int | None = None

    def write(self, sample: Sample) -> bool:
        """One line, with the time in s since the first sample; False where a line is dropped."""
        if self.sink.failure is not None:
            return True
        if self.first_ns is None:
            self.first_ns = sample.t_ns
        time_ns = sample.t_ns - self.first_ns
        cells = [
            f"{time_ns // 10**9}.{time_ns % 10**9:09d}",
            *map(repr, sample.values.tolist()),
        ]
        return self.sink(
            ",".join([*cells, *("1" if one else "0" for one in sample.valid)])
        )


@contextmanager
def sample_file(path: Path, n_channels: int) -> Iterator[SampleFile]:
    """A new file, written by its own thread. Raises OutputError."""
    sensors = n_channels // 3
    header = ",".join(
        [
            TIME_COLUMN,
            *channel_names(sensors),
            *(f"valid{k}" for k in range(1, sensors + 1)),
        ]
    )
    with file_sink(path, "--samples", header) as sink:
        yield SampleFile(sink)
