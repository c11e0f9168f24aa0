"""The link to a hand's controller or a cue device: a Unix socket or a serial port.

    unix:///PATH                  one datagram a line, to a socket file of its receiver
    serial:///dev/ttyX?baud=N     lines that end with a line feed; 115200 where no baud is given

A thread writes, so the loop never waits. It takes the newest line when the link has room: a line
that a newer one overtakes is left out and counted, so what arrives is never old. A link that fails,
or that has no room for EXPIRES_MS, is reported once and opened again, at first soon, then every two
seconds. Its first line is then `hold`. The last line of a run is `hold`. Where the process dies
without it, the receiver holds EXPIRES_MS after the last line.

A serial port carries few lines: 115200 baud about 55 a second. It is the one that pyserial opens
(extra `serial`). A line that was cut off is ended by the next line feed: a reader skips it.
"""

from __future__ import annotations

import errno
import math
import select
import socket
import termios
import time
from collections.abc import Callable
from contextlib import suppress
from threading import Condition, Thread
from typing import Any

from holdfast.core.errors import DeviceError, UsageError
from holdfast.core.hand_lines import LineUrl, line_url
from holdfast.drivers.serial_port import DEFAULT_BAUD, open_port
from holdfast.edge_runtime.supervisor import EXPIRES_MS

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
FIRST_RETRY_S, LAST_RETRY_S = 0.05, 2.0
"""From a failure to the first try, and the longest time between two tries."""
LAST_LINE_S = 0.2
"""The last line waits this long for room."""
END_S = 0.5
"""The end of a run waits this long for the thread."""
LOST = "link was lost"
HOLDS = "the hand holds its grip"
ADDRESSES = "unix:///run/hand/grip or serial:///dev/ttyUSB0?baud=115200"
FAILURES = (OSError, DeviceError, termios.error)
"""Of a port: a socket's, pyserial's and the system's."""
LastLine = Callable[[int, int, str], str]
"""(sequence, t_ns, reason) -> the line that ends a run, or begins after a failure."""
Report = Callable[[str], object]


class UnixPort:
    """A datagram socket to a receiver's socket file, which may come later, or anew.

    most_hz: commands a second that it carries.

    Who may write to the file may command its receiver: it should have permissions 0600.
    """

    most_hz = math.inf

    def __init__(self, path: str) -> None:
        self._path = path
        self._sender: socket.socket | None = None

    def open(self) -> None:
        """Find the receiver. Raises OSError."""
        self.close()
        sender = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
        sender.setblocking(False)
        try:
            sender.connect(self._path)
        except OSError:
            sender.close()
            raise
        self._sender = sender

    def wait_for_room(self, wait_s: float) -> None:
        """Wait for room in the receiver's queue. Raises OSError."""
        if self._sender is None:
            raise FileNotFoundError(errno.ENOENT, "there is no receiver")
        if not select.select([], [self._sender], [], wait_s)[1]:
            raise _stalled()

    def write(self, line: bytes) -> None:
        """Send one datagram. Raises OSError."""
        assert self._sender is not None
        self._sender.send(line)

    def finish(self, line: bytes) -> None:
        """Send the last line. Raises OSError."""
        self.wait_for_room(LAST_LINE_S)
        self.write(line)

    def close(self) -> None:
        """Close the socket."""
        if self._sender is not None:
            self._sender.close()
            self._sender = None


class SerialPort:
    """A serial port that may be unplugged and comes back."""

    def __init__(self, path: str, baud: int) -> None:
        self.most_hz = baud / BITS_A_COMMAND
        self._path = path
        self._baud = baud
        self._port: Any = None

    def open(self) -> None:
        """Open the port. Raises UsageError, DeviceError."""
        # an unplugged adapter gets another name as long as a process holds the old one
        self._lose()
        self._port = open_port(self._path, self._baud)
        self._port.write_timeout = PATIENCE_S
        # the modem lines stay as they are when it is closed: some boards reset on them
        flags = termios.tcgetattr(self._port.fd)
        flags[CONTROL_FLAGS] &= ~termios.HUPCL
        termios.tcsetattr(self._port.fd, termios.TCSANOW, flags)
        # ends a line that was cut off, so that the reader skips it
        self._port.write(b"\n")

    def wait_for_room(self, wait_s: float) -> None:
        """Wait until few bytes are unsent: a line behind many would arrive old."""
        end_s = time.monotonic() + wait_s
        while self._port.out_waiting > MOST_UNSENT:
            if time.monotonic() >= end_s:
                raise _stalled()
            time.sleep(LOOK_AGAIN_S)

    def write(self, line: bytes) -> None:
        """Write one line. Raises OSError where the port does not take it within PATIENCE_S."""
        self._port.write(line + b"\n")

    def finish(self, line: bytes) -> None:
        """Write the last line. It is worth more than what is unsent, which makes way for it."""
        try:
            self.wait_for_room(LAST_LINE_S)
        except TimeoutError:
            self._port.reset_output_buffer()
        self._port.write_timeout = LAST_LINE_S
        self.write(b"\n" + line)

    def close(self) -> None:
        """Close the port; what was written still leaves."""
        with suppress(*FAILURES):
            self._port.close()

    def _lose(self) -> None:
        """Close a port that failed, without waiting for what is unsent."""
        if self._port is not None and self._port.is_open:
            with suppress(*FAILURES):
                self._port.reset_output_buffer()
            self.close()


class HandLink:
    """One link with its thread and its retries. dropped: lines that did not leave.

    effect: of a link that fails, for people. works: lines leave.
    """

    def __init__(
        self,
        port: UnixPort | SerialPort,
        name: str,
        last: LastLine,
        report: Report,
        now_ns: Callable[[], int],
        effect: str = HOLDS,
    ) -> None:
        self.name = name
        self.most_hz = port.most_hz
        self.dropped = 0
        self.works = True
        self._port = port
        self._last = last
        self._report = report
        self._now_ns = now_ns
        self._effect = effect
        self._sequence = -1
        self._line: str | None = None
        self._ended = ""
        # guards the line that waits, its number and the end
        self._changed = Condition()
        self._thread = Thread(target=self._write_all, name="hand link", daemon=True)
        self._thread.start()

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
            self._ended = reason or "stopped"
            self._changed.notify()
        # bounded: a port that never opens must not keep the program from ending
        self._thread.join(END_S)
        if self.dropped:
            self._report(f"{self.name}: {self.dropped} lines did not leave")

    # -- in the thread

    def _write_all(self) -> None:
        while self._wait_for_line():
            try:
                self._port.wait_for_room(PATIENCE_S)
                self._port.write(self._newest().encode())
            except FAILURES as error:
                self._recover(error)
        self._finish()

    def _wait_for_line(self) -> bool:
        """Wait for a line; False where the run ends and none waits."""
        with self._changed:
            self._changed.wait_for(lambda: self._line is not None or self._ended)
            return self._line is not None

    def _newest(self) -> str:
        with self._changed:
            line, self._line = self._line, None
            return line or self._hold(LOST)

    def _recover(self, error: Exception) -> None:
        """Open the port again until a hold line leaves, or the run ends."""
        began_s = time.monotonic()
        with self._changed:
            self.works = False
            self.dropped += self._line is not None
            self._line = None
        reason = getattr(error, "strerror", None) or error
        self._report(f"{self.name}: no line arrives ({reason}); {self._effect}")

        wait_s = FIRST_RETRY_S
        while not self._ends_within(wait_s):
            # ever longer, so that a device that is gone costs little
            wait_s = min(2 * wait_s, LAST_RETRY_S)
            with suppress(*FAILURES):
                self._port.open()
                # a hold line: a command from before the failure would be old
                self._port.write(self._hold(LOST).encode())
                self.works = True
                after_s = time.monotonic() - began_s
                self._report(f"{self.name}: lines arrive again, after {after_s:.1f} s")
                return

    def _ends_within(self, wait_s: float) -> bool:
        with self._changed:
            return bool(self._changed.wait_for(lambda: self._ended, wait_s))

    def _hold(self, reason: str) -> str:
        # the number of a line that did not leave, above that of every line that did
        return self._last(self._sequence, self._now_ns(), reason)

    def _finish(self) -> None:
        line = self._last(self._sequence + 1, self._now_ns(), self._ended)
        with suppress(*FAILURES):
            if not self.works:
                self._port.open()
            self._port.finish(line.encode())
        self._port.close()


def _stalled() -> TimeoutError:
    return TimeoutError("its reader is stalled")


def open_hand_link(
    url: str,
    option: str,
    last: LastLine,
    report: Report,
    now_ns: Callable[[], int],
    effect: str = HOLDS,
) -> HandLink:
    """An open link, which ends with its last line when it is closed. option: its name for people.

    Raises UsageError, DeviceError.
    """
    try:
        port = _port_of(line_url(url))
    except ValueError as error:
        cause = str(error)
        if url.startswith("udp://"):
            cause = "nothing that moves a hand crosses a network"
        raise UsageError(
            f"{option} {url[:80]!r} is not an address",
            cause=cause,
            next_step=ADDRESSES,
        ) from None
    return HandLink(port, f"{option} {url}", last, report, now_ns, effect)


def _port_of(where: LineUrl) -> UnixPort | SerialPort:
    """Raises ValueError where a URL is no address, UsageError and DeviceError."""
    if where.parts.scheme not in ("unix", "serial"):
        raise ValueError("")
    # serial://dev/ttyX, with two slashes, would lose the first part of the path
    if where.parts.netloc or not where.path.strip("/"):
        raise ValueError("a path from / on, with three slashes")
    allowed = {"baud"} if where.parts.scheme == "serial" else set()
    if unknown := set(where.options) - allowed:
        raise ValueError(f"{min(unknown)[:40]!r} is no option of it")
    if where.parts.scheme == "unix":
        receiver = UnixPort(where.path)
        # one that starts later is found then; until then its absence is reported
        with suppress(OSError):
            receiver.open()
        return receiver

    baud = where.options.get("baud", str(DEFAULT_BAUD))
    if not baud.isdecimal() or len(baud) > 9:
        raise ValueError(f"baud={baud[:40]!r} is not a whole number")
    port = SerialPort(where.path, int(baud))
    # a port that is not there is a mistake now, and a fault later
    port.open()
    return port
