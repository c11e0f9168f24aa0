"""The link to a hand's controller or a cue device: a Unix socket or a serial port.

    unix:///PATH                  one datagram a line, to a socket file of its receiver
    serial:///dev/ttyX?baud=N     lines that end with a line feed; 115200 where no baud is given

A thread writes, so the loop never waits. It takes the newest line when the link has room: a line
that a newer one overtakes is left out and counted, so what leaves is never old. A receiver skips a
line that became old on its way (core/hand_lines.py). A link that fails, or that has no room for
EXPIRES_MS, is reported once, and tried again every RETRY_S. Its first line is then `hold`. The last
line of a run is `hold`. Where the process dies without it, the receiver holds EXPIRES_MS after the
last line.

A serial port carries few lines: 115200 baud about 55 a second. It is the one that pyserial opens
(extra `serial`). A line that was cut off is ended by the next line feed: a reader skips it.
"""

from __future__ import annotations

import math
import os
import select
import socket
import stat
import termios
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from threading import Condition, Thread
from typing import Any

from holdfast.core.errors import DeviceError, UsageError
from holdfast.core.hand_lines import not_an_address
from holdfast.drivers.line_feeds import close_port, open_port
from holdfast.edge_runtime.supervisor import EXPIRES_MS
from holdfast.live.sources import source_url

MOST_UNSENT = 96
"""A serial port that still has more bytes to send has no room for a line."""
BITS_A_COMMAND = 2100
"""About 210 bytes, ten bits each."""
CONTROL_FLAGS = 2
"""Their place in what tcgetattr returns."""
PATIENCE_S = 1e-3 * EXPIRES_MS
"""A link that has no room for so long has failed."""
LOOK_AGAIN_S = 0.002
"""Between two looks at how many bytes a port has still to send."""
LONGEST_PATH = 107
"""Bytes of the path of a socket file, by the system."""
RETRY_S = 0.2
"""From a failure to the first try, and between two tries."""
LAST_LINE_S = 0.2
"""The last line waits this long for room."""
END_S = 0.5
"""The end of a run waits this long for the thread."""
PSEUDO_TERMINALS = "/dev/pts/"
NO_QUEUE = (
    "a pseudo-terminal does not say how many bytes wait in it, so lines can arrive late: "
    "its reader must be fast, and skip old lines"
)
LOST = "link was lost"
HOLDS = "the hand holds its grip"
STALLED = "its reader is stalled"
FAILURES = (OSError, DeviceError, termios.error)
"""Of a port: a socket's, pyserial's and the system's."""
LastLine = Callable[[int, int, str], str]
"""(sequence, t_ns, reason) -> the line that ends a run, or begins after a failure."""
Report = Callable[[str], object]


class UnixPort:
    """A datagram socket to a receiver's socket file, which may come later, or anew.

    most_hz: commands a second that it carries. begins: what ends a line that was cut off.
    Who may write to the file may command its receiver: it should have permissions 0600.
    """

    most_hz = math.inf
    begins = b""

    def __init__(self, path: str) -> None:
        self._path = path
        self._is_connected = False
        self._sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        self._sender.setblocking(False)
        # one that starts later is found then; until then its absence is reported
        with suppress(OSError):
            self.open()

    def open(self) -> None:
        """Find the receiver, or the one that came in its place. Raises OSError."""
        self._is_connected = False
        self._sender.connect(self._path)
        self._is_connected = True

    def wait_for_room(self, wait_s: float) -> None:
        """Wait for room in the receiver's queue. Raises OSError."""
        if not select.select([], [self._sender], [], wait_s)[1]:
            raise TimeoutError(STALLED)

    def write(self, line: bytes) -> None:
        """Send one datagram. Raises OSError."""
        # without it, the error would be that of a missing connection, whatever stands in its way
        if not self._is_connected:
            self.open()
        self._sender.send(line)

    def close(self) -> None:
        self._sender.close()


class SerialPort:
    """A serial port that may be unplugged and comes back."""

    begins = b"\n"

    def __init__(self, path: str, baud: int) -> None:
        self.most_hz = baud / BITS_A_COMMAND
        self._path = path
        self._baud = baud
        # a port that is not there is a mistake now, and a fault later
        self._port = self._opened()

    def open(self) -> None:
        """Open the port again. Raises UsageError, DeviceError."""
        # an unplugged adapter gets another name as long as a process holds the old one
        with suppress(*FAILURES):
            # what is unsent must not be waited for
            self._port.reset_output_buffer()
        self.close()
        self._port = self._opened()

    def _opened(self) -> Any:
        port = open_port(self._path, self._baud)
        port.write_timeout = PATIENCE_S
        # the modem lines stay as they are when it is closed: some boards reset on them
        flags = termios.tcgetattr(port.fd)
        flags[CONTROL_FLAGS] &= ~termios.HUPCL
        termios.tcsetattr(port.fd, termios.TCSANOW, flags)
        port.write(self.begins)
        return port

    @property
    def is_pseudo_terminal(self) -> bool:
        """Whether it is the end of a pty, which never says how many bytes wait."""
        return os.ttyname(self._port.fd).startswith(PSEUDO_TERMINALS)

    def wait_for_room(self, wait_s: float) -> None:
        """Wait until few bytes are unsent: a line behind many would arrive old."""
        end_s = time.monotonic() + wait_s
        while self._port.out_waiting > MOST_UNSENT:
            if time.monotonic() >= end_s:
                raise TimeoutError(STALLED)
            time.sleep(LOOK_AGAIN_S)

    def write(self, line: bytes) -> None:
        """Write one line. Raises OSError where the port does not take it within PATIENCE_S."""
        self._port.write(line + b"\n")

    def close(self) -> None:
        close_port(self._port)


Port = UnixPort | SerialPort


@dataclass
class HandLink:
    """One link with its thread and its retries. dropped: lines that did not leave.

    name, effect: of the link, and of its failure, for people. works: lines leave. left: how many
    lines have left, not counting those that begin after a failure and that end the run.
    """

    port: Port
    name: str
    last: LastLine
    report: Report
    now_ns: Callable[[], int]
    effect: str = HOLDS
    dropped: int = 0
    left: int = 0
    works: bool = True
    _sequence: int = -1
    _line: str | None = None
    _ended: str = ""

    def __post_init__(self) -> None:
        # guards the line that waits, its number and the end
        self._changed = Condition()
        self._thread = Thread(target=self._write_all, name="hand link", daemon=True)
        self._thread.start()

    @property
    def carried_none(self) -> bool:
        """Whether no line has left of those that were passed on."""
        return self._sequence >= 0 and self.left == 0

    @property
    def idle(self) -> bool:
        """Whether the link works and no line waits."""
        return self.works and self._line is None

    def __call__(self, line: str, sequence: int) -> bool:
        """Pass a line on; it takes the place of one that still waits. False where none leaves."""
        with self._changed:
            self._sequence = sequence
            # counted also while the link is tried again: the controller missed it all the same
            self.dropped += self._line is not None or not self.works
            self._line = line if self.works else None
            self._changed.notify()
            return self.works

    def close(self, reason: str) -> None:
        """Write the last line, once, and report lines that did not leave."""
        with self._changed:
            if self._ended:
                return
            self._ended = reason
            self._changed.notify()
        # bounded: a port that never opens must not keep the program from ending
        self._thread.join(END_S)
        if self.dropped:
            self.report(f"{self.name}: {self.dropped} lines did not leave")

    # -- in the thread

    def _write_all(self) -> None:
        while self._wait_for_line():
            try:
                self.port.wait_for_room(PATIENCE_S)
                self.port.write(self._newest().encode())
                self.left += 1
            except FAILURES as error:
                self._recover(error)

        line = self.last(self._sequence + 1, self.now_ns(), self._ended)
        with suppress(*FAILURES):
            if not self.works:
                self.port.open()
            self.port.wait_for_room(LAST_LINE_S)
            self.port.write(self.port.begins + line.encode())
        self.port.close()

    def _wait_for_line(self) -> bool:
        """Wait for a line; False where the run ends and none waits."""
        with self._changed:
            self._changed.wait_for(lambda: self._line is not None or self._ended)
            return self._line is not None

    def _newest(self) -> str:
        with self._changed:
            line, self._line = self._line, None
            return line or self._hold()

    def _recover(self, error: Exception) -> None:
        """Open the port again until a hold line leaves, or the run ends."""
        began_s = time.monotonic()
        with self._changed:
            self.works = False
            self.dropped += self._line is not None
            self._line = None
        reason = getattr(error, "strerror", None) or error
        self.report(f"{self.name}: no line arrives ({reason}); {self.effect}")

        while not self._ends_within(RETRY_S):
            with suppress(*FAILURES):
                self.port.open()
                # a hold line: a command from before the failure would be old
                self.port.write(self._hold().encode())
                self.works = True
                after_s = time.monotonic() - began_s
                self.report(f"{self.name}: lines arrive again, after {after_s:.1f} s")
                return

    def _ends_within(self, wait_s: float) -> bool:
        with self._changed:
            return bool(self._changed.wait_for(lambda: self._ended, wait_s))

    def _hold(self) -> str:
        # the number of a line that did not leave, above that of every line that did
        return self.last(self._sequence, self.now_ns(), LOST)


def open_hand_link(
    url: str,
    name: str,
    last: LastLine,
    report: Report,
    now_ns: Callable[[], int],
    effect: str = HOLDS,
) -> HandLink:
    """An open link, which ends with its last line when it is closed. name: for people.

    Raises UsageError, DeviceError.
    """
    # serial://dev/ttyX, with two slashes, would lose the first part of the path
    if not url.startswith(("unix:///", "serial:///")):
        raise not_an_address(url, name, "unix:///PATH or serial:///DEVICE")
    where = source_url(url)
    if where.scheme == "unix":
        _require_possible(where.name, name)
        port: Port = UnixPort(where.name)
    else:
        port = SerialPort(where.name, where.options.baud)
        if port.is_pseudo_terminal:
            report(f"{name} {url}: {NO_QUEUE}")
    return HandLink(port, f"{name} {url}", last, report, now_ns, effect)


def _require_possible(path: str, link: str) -> None:
    """Raise UsageError for a path at which no receiver can come."""
    if len(os.fsencode(path)) > LONGEST_PATH:
        raise UsageError(
            f"{link}: unix://{path} is longer than {LONGEST_PATH} bytes, which no socket can have",
            next_step="choose a shorter path",
        )
    with suppress(OSError):
        if not stat.S_ISSOCK(os.stat(path).st_mode):
            raise UsageError(
                f"{link}: unix://{path} is no socket",
                next_step="name the socket file of the receiver; it may start later",
            )
