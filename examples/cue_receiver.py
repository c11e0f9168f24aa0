"""A vibration motor: plays the cues of `holdfast run`.

python examples/cue_receiver.py /run/hand/cues

holdfast.toml of the run has feedback = "unix:///run/hand/cues".
"""

import json
import os
import socket
import stat
import sys
import time
from contextlib import suppress

SILENT_NS = 3_000_000_000  # expires_ms
CLOCK = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)  # that of t_ns
LINK_LOST = "link lost", 1, 1500, 0, 0.5


def play(cue, pulses, on_ms, off_ms, strength):
    """Here the motor would run; this one only prints. A new cue ends the one before."""
    pulse = f"{on_ms} ms on, {off_ms} ms off, strength {strength:g}"
    print(f"{cue}: {pulses} x {pulse}", flush=True)


class Rising:
    """Which lines are obeyed: rising sequences only, until the sender is silent."""

    def __init__(self):
        self.newest = self.obeyed_ns = None

    def obeys(self, sequence, now_ns):
        """Whether a line is obeyed; it is then the newest."""
        lives = self.obeyed_ns is not None and now_ns - self.obeyed_ns <= SILENT_NS
        if lives and sequence <= self.newest:
            return False
        self.newest, self.obeyed_ns = sequence, now_ns
        return True


def whole(value, most):
    """A whole number from 0 on. Raises ValueError or TypeError."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
        raise ValueError("not a whole number from 0 on")
    return value


def read(line, now_ns):
    """(sequence, what to play), None for a line to skip, such as one that waited for long."""
    try:
        cue = json.loads(line)
        sequence, pulses = whole(cue["sequence"], 2**53), whole(cue["pulses"], 10)
        age_ns = now_ns - whole(cue["t_ns"], 10**18)
        on_ms, off_ms = (whole(cue[k], 60_000) for k in ("on_ms", "off_ms"))
        strength = cue["strength"]
        is_share = not isinstance(strength, bool) and 0 <= strength <= 1
        is_old = abs(age_ns) > SILENT_NS  # or its stamp is of another clock
        if is_old or not is_share or not cue["cue"].isprintable():
            return None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None  # cut off on the way, or something else
    return sequence, (cue["cue"][:40], pulses, on_ms, off_ms, strength)


def listen(path):
    """A socket at a path that only this user may write to; no other file is removed."""
    receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    with suppress(FileNotFoundError):
        if stat.S_ISSOCK(os.lstat(path).st_mode):
            try:
                receiver.connect(
                    path
                )  # a program that lives answers, and bind then fails
            except ConnectionRefusedError:
                os.unlink(path)  # left behind by one that ended
    os.fchmod(receiver.fileno(), 0o600)  # before bind: never wider, whatever the umask
    receiver.bind(path)
    return receiver


def main(path):
    """Play each cue as it comes; where no line comes, the wearer must feel that too."""
    try:
        rising, receiver = Rising(), listen(path)
    except OSError as error:
        raise SystemExit(f"{path}: {error.args[-1]}") from None
    receiver.settimeout(0.05)
    print("listening", flush=True)
    lost_ns = time.clock_gettime_ns(CLOCK) + SILENT_NS
    while True:
        try:
            line = receiver.recv(2048)
        except TimeoutError:
            line = b""
        now_ns = time.clock_gettime_ns(CLOCK)
        cue = read(line, now_ns)
        if cue and rising.obeys(cue[0], now_ns):
            lost_ns = now_ns + SILENT_NS
            if cue[1][1]:  # pulses; else a sign of life
                play(*cue[1])
        elif now_ns >= lost_ns:  # also while others send
            lost_ns = now_ns + SILENT_NS
            play(*LINK_LOST)


if __name__ == "__main__":
    main(sys.argv[1])
