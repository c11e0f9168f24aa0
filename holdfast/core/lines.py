"""Lines of text for streams and files, written by a thread: the caller never waits for them.

A write to a terminal, a pipe or a disk may never return: `poll` promises a terminal less room than
a line needs, and a regular file is always "ready". So a thread on which nothing depends does the
writing. Between it and the caller is a bounded queue. When the queue is full, its oldest line is
dropped, because the newest line is worth more.

A line is written whole or not at all. A line that a full disk cuts off is removed from the file. A
reader that goes away in the middle of a line gets no other half later, because the first error ends
the writer.
"""

from __future__ import annotations

import atexit
import errno
import io
import os
import select
import stat
import time
from queue import Empty, SimpleQueue
from threading import Thread
from typing import Protocol, TextIO

STREAM_LINES = 128
"""Lines that may wait for a terminal or a pipe: 0.85 s at 150 Hz, and more than a summary has."""
FILE_LINES = 4096
"""Lines that may wait for a disk: half a minute at 150 Hz, about 4 MB."""
CLOSING_S = 0.2
"""Closing waits this long for the lines in the queue.

`holdfast run` closes three times in a row and ends within a second.
"""
STUCK_S = 0.1
"""A writer that finishes no line in this time while it closes is taken as dead."""
RETRY_S = 0.01
"""Pause between attempts on a non-blocking descriptor that wrongly reports to be ready."""


class Sink(Protocol):
    """Takes lines without waiting."""

    name: str

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


class LineWriter:
    """A sink whose thread writes to `handle`; it owns the handle and closes it after the last line.

    handle: an open descriptor, or None for one that is already closed. header: the first line,
    which is never dropped. failure: the first error, or None; after it nothing more is written.
    offered, written: lines so far. A writer that is still open when Python ends is closed then.
    """

    def __init__(
        self, handle: int | None, name: str = "", header: str | None = None
    ) -> None:
        self.name = name
        self.failure: OSError | None = None
        self.offered = self.written = 0
        self._waiting: SimpleQueue[str | None] = SimpleQueue()
        self._ended = self._given_up = False
        if handle is None:
            self.failure = OSError(errno.EBADF, os.strerror(errno.EBADF))
            return
        self._most = FILE_LINES if is_regular(handle) else STREAM_LINES
        self._thread = Thread(
            target=self._write_all,
            args=(handle, header),
            name="line writer",
            daemon=True,
        )
        self._thread.start()
        atexit.register(self.close)

    @property
    def dropped(self) -> int:
        """Lines offered and not written.

        Before `close` has returned, waiting lines are among them.
        """
        return self.offered - self.written

    def __call__(self, line: str) -> bool:
        """Queue one line; False where it, or the oldest line instead, is dropped.

        line: without its line break.
        """
        self.offered += 1
        if self.failure is not None or self._ended:
            return False
        # only this thread adds lines, so the queue cannot grow in between
        room = self._waiting.qsize() < self._most
        if not room:
            self._forget_one()
        self._waiting.put(line)
        return room

    def end(self) -> None:
        """Take no more lines; the waiting ones are still written."""
        if not self._ended:
            self._ended = True
            self._waiting.put(None)

    def close(self, wait_s: float = CLOSING_S) -> None:
        """`end`, and wait at most wait_s for the last line; drop the others."""
        atexit.unregister(self.close)
        self.end()
        if self.failure is not None or self._given_up:
            return
        self._thread.join(wait_s)
        if self._thread.is_alive():
            self._give_up()

    def _give_up(self) -> None:
        """Leave the thread in the write that it waits for; nothing follows that write."""
        self._given_up = True
        while self._forget_one():
            pass
        self._waiting.put(None)

    def _forget_one(self) -> bool:
        try:
            self._waiting.get_nowait()
        except Empty:
            return False
        return True

    def _write_all(self, handle: int, header: str | None) -> None:
        """Write every line until the end or the first error, which may come from closing."""
        try:
            try:
                if header is not None:
                    write_whole_line(handle, header.encode() + b"\n")
                while (line := self._waiting.get()) is not None:
                    data = line.encode("utf-8", "backslashreplace") + b"\n"
                    write_whole_line(handle, data)
                    self.written += 1
            finally:
                os.close(handle)
        except OSError as error:
            self.failure = error


class TextSink:
    """A text object in memory: it has no descriptor, and writing to it never blocks."""

    failure: OSError | None = None
    dropped = 0

    def __init__(self, stream: TextIO, name: str) -> None:
        self.name = name
        self._stream = stream

    def __call__(self, line: str) -> bool:
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
    try:
        # a new descriptor for the same file, which no other code closes
        return LineWriter(os.dup(handle), name)
    except OSError:
        return LineWriter(None, name)


def write_whole_line(handle: int, data: bytes) -> None:
    """Write all of it, however long that takes. Raises OSError.

    A regular file keeps its old length then.
    """
    done = 0
    try:
        while done < len(data):
            done += _write_some(handle, data[done:])
    except OSError:
        if done and is_regular(handle):
            _take_back(handle, done)
        raise


def _write_some(handle: int, data: bytes) -> int:
    """How many bytes were written; 0 where a non-blocking descriptor has no room yet."""
    try:
        return os.write(handle, data)
    except BlockingIOError:
        ready = select.poll()
        ready.register(handle, select.POLLOUT)
        ready.poll()
        time.sleep(RETRY_S)
        return 0


def _take_back(handle: int, n_bytes: int) -> None:
    """Remove the bytes just written, if they are the file's last ones.

    Another program may append to the same file.
    """
    end = os.lseek(handle, 0, os.SEEK_CUR)
    if end == os.fstat(handle).st_size:
        os.ftruncate(handle, end - n_bytes)
        os.lseek(handle, end - n_bytes, os.SEEK_SET)


def is_regular(handle: int) -> bool:
    """Whether it is a file on a disk."""
    return stat.S_ISREG(os.fstat(handle).st_mode)
