"""Lines written to a file descriptor by a thread of its own: the caller never waits, whatever the
descriptor does.

A write to a terminal, a pipe or a disk may take for ever: `poll` promises a terminal less room than
a line needs, and a regular file is always "ready". So only a thread that nothing depends on writes.
Between it and the caller stands a bounded queue; when the queue is full, its oldest line is
dropped, because the newest is worth more.

A line is written whole or not at all. One that a full disk cut off is taken back from the file; a
reader that goes away in the middle of a line gets no other half later, because the first error ends
the writer.
"""

from __future__ import annotations

import errno
import os
import select
import stat
import time
from queue import Empty, SimpleQueue
from threading import Thread

STREAM_LINES = 128
"""Lines that may wait for a terminal or a pipe: not quite a second at 150 Hz, and more than a
summary has."""
FILE_LINES = 4096
"""Lines that may wait for a disk: half a minute at 150 Hz, about 4 MB."""
CLOSING_S = 0.2
"""So long closing waits for lines under way. `holdfast run` closes three times in a row and ends
within a second."""
STUCK_S = 0.1
"""A writer that has not finished one line in so long while it closes waits for something that is
dead."""
RETRY_S = 0.01
"""Between attempts on a descriptor that is non-blocking and says that it is ready when it is
not."""


class LineWriter:
    """Hands lines to a thread that writes them to `handle`, which the writer owns from now on and
    closes.

    handle: an open descriptor, or None for one that is closed already. header: the first line,
    which no newer replaces. failure: the first error, or None. After it nothing more is written.
    offered, written: lines so far.
    """

    def __init__(self, handle: int | None, header: str | None = None) -> None:
        self.failure: OSError | None = None
        self.offered = self.written = 0
        self._waiting: SimpleQueue[str | None] = SimpleQueue()
        self._closed = self._given_up = False
        if handle is None:
            self.failure = OSError(errno.EBADF, os.strerror(errno.EBADF))
            return
        self._most = FILE_LINES if is_regular(handle) else STREAM_LINES
        self._thread = Thread(
            target=self._write_all, args=(handle, header), name="line writer", daemon=True
        )
        self._thread.start()

    @property
    def dropped(self) -> int:
        """Lines offered and not written; before `close` has returned, those that still wait are
        among them."""
        return self.offered - self.written

    def put(self, line: str) -> bool:
        """Queue one line, without its line break; False where it, or the oldest instead of it, is
        dropped."""
        self.offered += 1
        if self.failure is not None or self._closed:
            return False
        room = self._waiting.qsize() < self._most
        if not room:
            self._forget_one()
        self._waiting.put(line)
        return room

    def end(self) -> None:
        """Take no more lines; those that wait are still written."""
        if not self._closed:
            self._closed = True
            self._waiting.put(None)

    def close(self, wait_s: float = CLOSING_S) -> None:
        """`end`, and wait for the last line while lines are written, at most wait_s; the others are
        dropped."""
        self.end()
        if self.failure is not None or self._given_up:
            return
        end_s = time.monotonic() + wait_s
        while self._goes_on(end_s):
            pass
        if self._thread.is_alive():
            self._give_up()

    def _goes_on(self, end_s: float) -> bool:
        """Wait a little; whether the thread wrote lines meanwhile and is to write more before
        end_s."""
        before = self.written
        self._thread.join(max(0.0, min(STUCK_S, end_s - time.monotonic())))
        return self._thread.is_alive() and self.written > before and time.monotonic() < end_s

    def _give_up(self) -> None:
        """Leave the thread in the write that it waits for; nothing follows it."""
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
        """What the thread does: every line until the end or the first error, which a close can be
        too."""
        try:
            try:
                if header is not None:
                    write_whole_line(handle, header.encode() + b"\n")
                while (line := self._waiting.get()) is not None:
                    write_whole_line(handle, line.encode("utf-8", "backslashreplace") + b"\n")
                    self.written += 1
            finally:
                os.close(handle)
        except OSError as error:
            self.failure = error


def write_whole_line(handle: int, data: bytes) -> None:
    """Write all of it, waiting as long as it takes. Raises OSError; a regular file is then as long
    as it was before."""
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
    """Shorten the file by the bytes just written, where they are its last ones (another program may
    append too)."""
    end = os.lseek(handle, 0, os.SEEK_CUR)
    if end == os.fstat(handle).st_size:
        os.ftruncate(handle, end - n_bytes)
        os.lseek(handle, end - n_bytes, os.SEEK_SET)


def is_regular(handle: int) -> bool:
    """Whether it is a file on a disk."""
    return stat.S_ISREG(os.fstat(handle).st_mode)
