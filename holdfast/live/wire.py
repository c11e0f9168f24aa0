"""A wire to a hand's controller or to a cue device, which must never be left with an old line.

The loop writes each line itself and never waits. A wire that fails, or that takes no line for
EXPIRES_MS, is reported once and tried again, at first soon, then every two seconds. When it takes
lines again its first ones are `hold`, and the report says so. The last line of a run is `hold`.
Where the process dies without it, the receiver holds EXPIRES_MS after the last line.
"""

from __future__ import annotations

import errno
from collections.abc import Callable
from contextlib import suppress

from holdfast.edge_runtime.supervisor import EXPIRES_MS
from holdfast.live.links import Link, open_link

FIRST_RETRY_NS = 50_000_000
"""From a failure to the first new try: 50 ms."""
LAST_RETRY_NS = 2_000_000_000
"""The longest time between two tries: 2 s."""
TRIALS = 3
"""A wire works again after this many lines; a socket reports an error only at the next line."""
LOST = "link was lost"
HOLDS = "the hand holds its grip"
LastLine = Callable[[int, int, str], str]
"""(sequence, t_ns, reason) -> the line that ends a run, or begins after a failure."""


class Wire:
    """One link with its retries. dropped: lines that did not leave.

    most_hz: commands a second that the link carries. effect: of a link that fails, for people.
    """

    def __init__(
        self,
        link: Link,
        last: LastLine,
        report: Callable[[str], object],
        now_ns: Callable[[], int],
        effect: str = HOLDS,
    ) -> None:
        self._link = link
        self._last = last
        self._now_ns = now_ns
        self._report = report
        self._effect = effect
        self.name = link.name
        self.most_hz = link.most_hz
        self.dropped = 0
        self._sequence = -1
        self._works = True
        self._closed = False
        self._trials = 0
        self._failed_ns = self._retry_ns = 0
        self._wait_ns = FIRST_RETRY_NS
        self._full_since_ns: int | None = None

    def __call__(self, line: str, sequence: int) -> bool:
        """Pass a line on; False where it did not leave."""
        self._sequence = sequence
        now_ns = self._now_ns()
        taken = self._works and self._write(line, now_ns)
        if not self._works:
            self._retry(now_ns)
        # counted also while the wire is tried again: the controller missed them all the same
        self.dropped += not taken
        return taken

    def look(self, sequence: int) -> None:
        """Try a wire that failed again, where there is no line to pass on."""
        if not self._works:
            # a hold line, too, must have a later number than the line before it
            self._sequence = sequence
            self._retry(self._now_ns())

    def close(self, reason: str) -> None:
        """Write the last line, once, and report lines that did not leave."""
        if self._closed:
            return
        # set first: a failure while closing must not lead to a second last line
        self._closed = True
        line = self._last(self._sequence + 1, self._now_ns(), reason)
        with suppress(OSError, ValueError):
            self._link.finish(line.encode())
        self._link.close()
        if self.dropped:
            self._report(f"{self.name}: {self.dropped} lines did not leave")

    def _write(self, line: str, now_ns: int) -> bool:
        try:
            taken = self._link.write(line.encode())
        except OSError as error:
            self._fail(error, now_ns)
            return False

        # a full buffer is no error at first: the reader may be slow for a moment
        if taken:
            self._full_since_ns = None
        elif self._full_since_ns is None:
            self._full_since_ns = now_ns
        elif now_ns - self._full_since_ns > 1_000_000 * EXPIRES_MS:
            self._fail(_stalled(), now_ns)

        return taken

    def _fail(self, error: OSError, now_ns: int) -> None:
        if self._works:
            self._failed_ns = now_ns
            self._wait_ns = FIRST_RETRY_NS
            reason = error.strerror or error
            self._report(f"{self.name}: no line arrives ({reason}); {self._effect}")
        else:
            # ever longer, so that a device that is gone costs the loop little
            self._wait_ns = min(2 * self._wait_ns, LAST_RETRY_NS)

        # an unplugged adapter gets another name as long as a process holds the old one, and a
        # receiver that starts again makes a new socket file
        if self._link.reconnects and error.errno != errno.EAGAIN:
            self._link.lose()

        self._works = False
        self._trials = 0
        self._retry_ns = now_ns + self._wait_ns

    def _retry(self, now_ns: int) -> None:
        """Try a hold line in place of the command, when its time has come."""
        # opening a port takes a thread and time, so the line waits until it is open
        if now_ns < self._retry_ns or not self._link.reopen():
            return
        # a hold line: a command from before the failure would be old
        line = self._last(self._sequence, now_ns, LOST)
        try:
            if not self._link.write(line.encode()):
                raise _stalled()
        except OSError as error:
            self._fail(error, now_ns)
            return

        self._trials += 1
        if self._trials >= TRIALS:
            self._works = True
            self._full_since_ns = None
            after_s = 1e-9 * (now_ns - self._failed_ns)
            self._report(f"{self.name}: lines arrive again, after {after_s:.1f} s")


def _stalled() -> OSError:
    return OSError(errno.EAGAIN, "its reader is stalled")


def open_wire(
    url: str,
    option: str,
    last: LastLine,
    report: Callable[[str], object],
    now_ns: Callable[[], int],
    effect: str = HOLDS,
) -> Wire:
    """An open wire, which ends with its last line when it is closed.

    Raises UsageError, DeviceError.
    """
    return Wire(open_link(url, option), last, report, now_ns, effect)
