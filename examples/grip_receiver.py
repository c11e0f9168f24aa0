"""A hand's own controller: its wearer first, then the commands of `holdfast run --grip URL`.

python examples/grip_receiver.py /run/hand/grip       --grip unix:///run/hand/grip
"""

import json
import os
import select
import socket
import sys
import time

SILENT_NS = 300_000_000  # expires_ms
FILTER_NS = 0  # 60_000_000 in a hand that does not filter muscle artefacts itself
CEILING_N, SLEW_N_S = 70.0, 400.0  # what this hand allows, whatever is commanded
MODES = "idle", "hold", "tighten", "relax", "yield"
HOLD = "hold", "the grip it has", 0.0, "no command for 300 ms"
OPEN = "open", "the wearer's grip", SLEW_N_S, "the wearer opens"


def wearer(word):
    """To fill in: what the wearer commands now. Here a line: open, close, stop, or empty."""
    typed = os.read(0, 4096).split() if select.select([0], [], [], 0)[0] else []
    return typed[-1].decode(errors="replace") if typed else word


def move(mode, grip, slew_n_s, reason):
    """To fill in: here the motor would be moved; this hand only prints."""
    grip = grip if isinstance(grip, str) else f"{grip:.1f} N"
    print(f"{mode}: {grip}, at most {slew_n_s:.0f} N/s ({reason})", flush=True)


class Receiver:
    """What the motor does: the wearer's opening, else the newest command, else hold."""

    def __init__(self, filter_ns=FILTER_NS):
        self.filter_ns, self.command, self.opened = filter_ns, HOLD, False
        self.newest = self.silent_ns = self.opens_ns = -1

    def answer(self, line, word, now_ns):
        """(mode, grip, N/s, reason) at a sample. line: b"" for none; word: of `wearer`."""
        if now_ns > self.silent_ns:  # also while others send
            self.newest, self.command = -1, HOLD
        sequence, command = read(line)
        if sequence > self.newest:
            self.newest, self.command = sequence, command
            self.silent_ns = now_ns + SILENT_NS
        if word != "open":
            self.opens_ns = now_ns + self.filter_ns
            self.opened = self.opened and word not in ("close", "empty")
        elif now_ns >= self.opens_ns:
            self.opened = True  # until the hand was empty, or the wearer closes
        return OPEN if self.opened else self.command


def read(line):
    """(sequence, (mode, grip, N/s, reason)) of a command; the sequence -1 for another line."""
    try:
        fields = json.loads(line)
        mode, reason, grip = (fields[k] for k in ("mode", "reason", "target_n"))
        sequence, slew_n_s = fields["sequence"], fields["slew_n_s"]
        numbers = [sequence, slew_n_s, 0 if grip is None else grip]
        fine = [type(n) in (int, float) and 0 <= n < 1e300 for n in numbers]
        if mode not in MODES or not reason.isprintable() or not all(fine):
            return -1, HOLD
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return -1, HOLD  # cut off on the way, or something else
    grip = "the grip it has" if grip is None else min(grip, CEILING_N)
    return sequence, (mode, grip, min(slew_n_s, SLEW_N_S), reason[:40])


def main(path):
    """Answer at each sample: when a line comes, and every 10 ms without one."""
    link = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    if os.path.exists(path):
        os.unlink(path)
    os.fchmod(link.fileno(), 0o600)  # before bind: for this user, whatever the umask
    link.bind(path)
    print("listening", flush=True)
    own, word, before = Receiver(), "", HOLD
    while True:
        line = link.recv(2048) if select.select([link], [], [], 0.01)[0] else b""
        answer = own.answer(line, word := wearer(word), time.monotonic_ns())
        if answer != before:
            move(*answer)
        before = answer


if __name__ == "__main__":
    main(sys.argv[1])
