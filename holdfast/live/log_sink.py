"""Lines into a text stream: what a sink is, and the sinks that logs are."""

from __future__ import annotations

import atexit
import io
import os
from typing import Literal, Protocol, TextIO

from holdfast.live.line_writer import CLOSING_S, LineWriter

Kind = Literal["log", "acting"]


class Sink(Protocol):
    """Takes lines without waiting."""

    name: str
    kind: Kind

    @property
    def failure(self) -> OSError | None:
        """The error after which it takes no more lines, or None."""
        ...

    @property
    def dropped(self) -> int:
        """How many lines it received and did not pass on."""
        ...

    def __call__(self, line: str) -> bool:
        """Pass a line on; False where this line, or an older one instead, is dropped."""
        ...

    def end(self) -> None:
        """Take no more lines, without waiting for those in the queue."""
        ...

    def close(self, wait_s: float = CLOSING_S) -> None:
        """`end`, and wait at most wait_s for the lines in the queue."""
        ...


class LogSink:
    """A descriptor written by its own thread; an open sink is also closed when Python ends."""

    kind: Kind = "log"

    def __init__(
        self, handle: int | None, name: str, header: str | None = None
    ) -> None:
        self.name = name
        self._writer = LineWriter(handle, header)
        self.end = self._writer.end
        atexit.register(self.close)

    @property
    def failure(self) -> OSError | None:
        """The first error of a write, or None."""
        return self._writer.failure

    @property
    def dropped(self) -> int:
        """Lines that were not written.

        Before `close` has returned, waiting lines are among them.
        """
        return self._writer.dropped

    def __call__(self, line: str) -> bool:
        """Queue a line for the thread."""
        return self._writer.put(line)

    def close(self, wait_s: float = CLOSING_S) -> None:
        """Wait at most wait_s for the waiting lines.

        The descriptor is closed after the last one.
        """
        atexit.unregister(self.close)
        self._writer.close(wait_s)


class TextSink:
    """A text object in memory: it has no descriptor, and writing to it never blocks."""

    kind: Kind = "log"
    failure: OSError | None = None
    dropped = 0

    def __init__(self, stream: TextIO, name: str) -> None:
        self.name = name
        self._stream = stream

    def __call__(self, line: str) -> bool:
        """Write it."""
        self._stream.write(line + "\n")
        return True

    def end(self) -> None:
        """No line is waiting."""

    def close(self, wait_s: float = CLOSING_S) -> None:
        """No line is waiting."""


def stream_sink(stream: TextIO, name: str = "") -> Sink:
    """A sink that writes line by line to a stream's descriptor, so no reader waits for a buffer.

    It stays open until its `close`, or until Python ends; the stream itself may be closed before.
    """
    name = name or str(getattr(stream, "name", "stream")).strip("<>")
    try:
        handle = stream.fileno()
    except (io.UnsupportedOperation, AttributeError, ValueError):
        return TextSink(stream, name)
    stream.flush()
    return LogSink(_own(handle), name)


def _own(handle: int) -> int | None:
    """A new descriptor for the same file, which no other code closes; None if it is closed."""
    try:
        return os.dup(handle)
    except OSError:
        return None
