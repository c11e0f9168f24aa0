"""A hand's own controller: receives the commands of `holdfast run --grip URL`.

python examples/grip_receiver.py /run/hand/grip       --grip unix:///run/hand/grip
"""

import json
import os
import socket
import sys
import time

SILENT_NS = 300_000_000  # expires_ms
CEILING_N, SLEW_N_S = 70.0, 400.0  # what this hand allows, whatever is commanded
MODES = "idle", "hold", "tighten", "relax", "yield"


def move(mode, target_n, slew_n_s, reason):
    """Here the motor would be moved; this hand only prints."""
    grip = "the grip it has" if target_n is None else f"{target_n:.1f} N"
    print(f"{mode}: {grip}, at most {slew_n_s:.0f} N/s ({reason})", flush=True)


class Rising:
    """Which lines are obeyed: rising sequences only, until the sender is silent."""

    def __init__(self):
        self.newest = self.obeyed_ns = None

    def lives(self, now_ns):
        """Whether a line was obeyed in the last 300 ms."""
        return self.obeyed_ns is not None and now_ns - self.obeyed_ns <= SILENT_NS

    def obeys(self, sequence, now_ns):
        """Whether a line is obeyed; it is then the newest."""
        if self.lives(now_ns) and sequence <= self.newest:
            return False
        self.newest, self.obeyed_ns = sequence, now_ns
        return True


def number(value, most):
    """A number from 0 on, at most `most`. Raises ValueError or TypeError."""
    if isinstance(value, bool) or not value >= 0:  # not a number: neither is true
        raise ValueError("not a number from 0 on")
    return min(value, most)


def read(line):
    """(sequence, (mode, target_n, slew_n_s, reason)), None for a line to skip."""
    try:
        command = json.loads(line)
        mode, reason, target_n = (command[k] for k in ("mode", "reason", "target_n"))
        if mode not in MODES or not reason.isprintable():
            return None
        if target_n is not None:
            target_n = number(target_n, CEILING_N)
        slew_n_s = number(command["slew_n_s"], SLEW_N_S)
        sequence = int(number(command["sequence"], 2**53))
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None  # cut off on the way, or something else
    return sequence, (mode, target_n, slew_n_s, reason[:40])


def listen(path):
    """A socket at a path that only this user may write to."""
    receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    if os.path.exists(path):
        os.unlink(path)
    os.fchmod(receiver.fileno(), 0o600)  # before bind: never wider, whatever the umask
    receiver.bind(path)
    return receiver


def main(path):
    """Obey rising commands; hold where none has come for 300 ms."""
    rising, receiver = Rising(), listen(path)
    receiver.settimeout(0.05)
    print("listening", flush=True)
    holds = True
    while True:
        try:
            line = receiver.recv(2048)
        except TimeoutError:
            line = b""
        now_ns = time.monotonic_ns()
        if not holds and not rising.lives(now_ns):  # also while others send
            move("hold", None, 0.0, "no command for 300 ms")
            holds = True
        command = read(line)
        if command and rising.obeys(command[0], now_ns):
            move(*command[1])
            holds = False


if __name__ == "__main__":
    main(sys.argv[1])
