"""A hand's own controller: its wearer first, then the commands of `holdfast run --grip URL`.

python examples/grip_receiver.py /run/hand/grip       --grip unix:///run/hand/grip
python examples/grip_receiver.py /dev/ttyS1           --grip serial:///dev/ttyUSB0
"""

import json
import os
import select
import socket
import stat
import sys
import termios
import time
from contextlib import suppress

SILENT_NS = 300_000_000  # expires_ms
# the same over a wire, on which the fastest line takes up to 100 ms
LATE_NS = 200_000_000
# where t_ns falls by more, the clock of the sender has begun anew
RESTART_NS = 100_000_000
DRIFT = 0.006  # the clocks of two machines part by at most 6 ms a second
FILTER_NS = 0  # 60_000_000 in a hand that does not filter muscle artefacts itself
CEILING_N, SLEW_N_S = 70.0, 400.0  # what this hand allows, whatever is commanded
# of a serial port, as in --grip "serial:///dev/ttyUSB0?baud=115200"
BAUD = termios.B115200
CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # that of t_ns
MODES = "idle", "hold", "tighten", "relax", "yield"
HOLD = "hold", "the grip it has", 0.0, "no command for 300 ms"
OPEN = "open", "the wearer's grip", SLEW_N_S, "the wearer opens"


class Wearer:
    """To fill in: what the wearer commands. Here typed lines: open, close, stop, empty."""

    rest = b""

    def words(self):
        """Each word that is new; one that counts for a moment must not be left out."""
        while select.select([0], [], [], 0)[0] and (came := os.read(0, 4096)):
            self.rest += came
        *words, self.rest = self.rest.split(b"\n")
        return [word.strip().decode(errors="replace") for word in words]


def move(mode, grip, slew_n_s, reason):
    """To fill in: here the motor would be moved; this hand only prints."""
    grip = grip if isinstance(grip, str) else f"{grip:.1f} N"
    print(f"{mode}: {grip}, at most {slew_n_s:.0f} N/s ({reason})", flush=True)


class SameClock:
    """Ages of lines from the same machine: t_ns is of the clock that now_ns is of."""

    def is_old(self, t_ns, now_ns):
        """Also a stamp of the future is of another clock: the age of its line is unknown."""
        return abs(now_ns - t_ns) > SILENT_NS


class OtherClock:
    """Ages of lines over a wire, whose sender has another clock: how much later than the fastest.

    A delay that every line has from the first on is not seen, nor one that stands for minutes.
    """

    newest_ns = None

    def begin(self):
        """The wire was opened."""
        self.newest_ns = None

    def is_old(self, t_ns, now_ns):
        """Also every line of the first 300 ms is, in which the fastest is found."""
        lag_ns = now_ns - t_ns
        if self.newest_ns is None or t_ns < self.newest_ns - RESTART_NS:
            self.fastest_ns, self.begins_ns = lag_ns, now_ns + SILENT_NS
        else:
            risen_ns = self.fastest_ns + DRIFT * (now_ns - self.came_ns)
            self.fastest_ns = min(lag_ns, risen_ns)
        self.newest_ns, self.came_ns = t_ns, now_ns
        return now_ns < self.begins_ns or lag_ns - self.fastest_ns > LATE_NS


class Receiver:
    """What the motor does: the wearer's opening, else the newest command, else hold."""

    def __init__(self, clock, filter_ns=FILTER_NS):
        self.clock, self.filter_ns, self.command = clock, filter_ns, HOLD
        self.newest = self.silent_ns = self.opens_ns = -1
        self.opened = self.has_told = False

    def answer(self, line, word, now_ns):
        """(mode, grip, N/s, reason) at a sample. line: b"" for none; word: of `wearer`."""
        if now_ns > self.silent_ns:  # also while others send
            self.newest, self.command = -1, HOLD
        sequence, t_ns, command = read(line)
        if sequence >= 0 and self.clock.is_old(t_ns, now_ns):
            self.tell_once()
        elif sequence > self.newest:
            self.newest, self.command = sequence, command
            self.silent_ns = now_ns + SILENT_NS
        if word != "open":
            self.opens_ns = now_ns + self.filter_ns
            self.opened = self.opened and word not in ("close", "empty")
        elif now_ns >= self.opens_ns:
            self.opened = True  # until the hand was empty, or the wearer closes
        return OPEN if self.opened else self.command

    def tell_once(self):
        """Say that lines are skipped; a log must not fill."""
        if not self.has_told:
            print(
                "lines of over 300 ms, or of another clock, are skipped",
                file=sys.stderr,
            )
        self.has_told = True


def read(line):
    """(sequence, t_ns, (mode, grip, N/s, reason)); the sequence -1 for a line to skip."""
    try:
        fields = json.loads(line)
        mode, reason, grip = (fields[k] for k in ("mode", "reason", "target_n"))
        sequence, t_ns, slew_n_s = (fields[k] for k in ("sequence", "t_ns", "slew_n_s"))
        numbers = [sequence, slew_n_s, 0 if grip is None else grip]
        fine = [type(n) in (int, float) and 0 <= n < 1e300 for n in numbers]
        is_stamp = type(t_ns) is int and 0 <= t_ns < 10**18
        if mode not in MODES or not reason.isprintable() or not all(fine):
            return -1, 0, HOLD
        if not is_stamp:
            return -1, 0, HOLD
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return -1, 0, HOLD  # cut off on the way, or something else
    grip = "the grip it has" if grip is None else min(grip, CEILING_N)
    return sequence, t_ns, (mode, grip, min(slew_n_s, SLEW_N_S), reason[:40])


class Link:
    """What brings lines: a Unix socket of its own, or a serial port. Raises SystemExit."""

    def __init__(self, path):
        self.path, self.rest = path, b""
        self.is_wire = os.path.exists(path) and stat.S_ISCHR(os.stat(path).st_mode)
        self.clock = OtherClock() if self.is_wire else SameClock()
        try:
            self.handle = opened(path) if self.is_wire else listening(path)
        except (OSError, termios.error) as error:
            raise SystemExit(f"{path}: {error.args[-1]}") from None
        self.drop()

    def lines(self, wait_s):
        """What has come; waits at most so long for the first of it."""
        if not select.select([self.handle], [], [], wait_s)[0]:
            return []
        try:
            came = os.read(self.handle, 2048)
        except BlockingIOError:  # another program took it
            return []
        except OSError:
            came = b""
        if not self.is_wire:
            return [came]
        if not came:  # unplugged
            self.open_again(wait_s)
        *lines, rest = (self.rest + came).split(b"\n")
        self.rest = rest[-2048:]
        return lines

    def open_again(self, wait_s):
        """A port that was unplugged comes back, perhaps with another sender."""
        time.sleep(wait_s)
        with suppress(OSError, termios.error):
            again = opened(self.path)
            os.close(self.handle)
            self.handle, self.rest = again, b""
            self.clock.begin()

    def drop(self):
        """Leave out what waits: its age is unknown."""
        while self.lines(0.0):
            pass


def opened(path):
    """A serial port that passes bytes as they are."""
    port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    special = termios.tcgetattr(port)[6]
    special[termios.VMIN] = 1  # an empty read then means that the port is gone
    raw = [0, 0, termios.CS8 | termios.CREAD | termios.CLOCAL, 0, BAUD, BAUD, special]
    termios.tcsetattr(port, termios.TCSANOW, raw)
    return port


def listening(path):
    """A socket at a path that only this user may write to; no other file is removed."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    with suppress(FileNotFoundError):
        if stat.S_ISSOCK(os.lstat(path).st_mode):
            try:
                link.connect(path)  # a program that lives answers, and bind then fails
            except ConnectionRefusedError:
                os.unlink(path)  # left behind by one that ended
    os.fchmod(link.fileno(), 0o600)  # before bind: for this user, whatever the umask
    link.bind(path)
    return link.detach()


def main(path):
    """Answer at each sample: when a line comes, and every 10 ms without one."""
    link, typed = Link(path), Wearer()
    own, word, before = Receiver(link.clock), "", HOLD
    print("listening", flush=True)
    while True:
        began_ns = time.clock_gettime_ns(CLOCK)
        lines = link.lines(0.01)
        now_ns = time.clock_gettime_ns(CLOCK)
        # this program was stopped: what waited is old
        if now_ns - began_ns > SILENT_NS:
            link.drop()
            lines = []
        answers = [own.answer(b"", word := one, now_ns) for one in typed.words()]
        answers += [own.answer(line, word, now_ns) for line in lines or [b""]]
        for answer in answers:
            if answer != before:
                move(*answer)
            before = answer


if __name__ == "__main__":
    main(sys.argv[1])
