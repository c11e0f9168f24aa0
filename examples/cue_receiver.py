"""A vibration motor: plays the cues of `holdfast run --feedback URL`.

python examples/cue_receiver.py /run/hand/cues     --feedback unix:///run/hand/cues
python examples/cue_receiver.py 9002               --feedback udp://127.0.0.1:9002

With a key: as in grip_receiver.py, with b"feedback\\n" in place of b"grip\\n".
"""

import json
import os
import socket
import sys
import time

MOST_AHEAD = 4 * 150  # samples: a second, and the three that lines may be apart
SILENT_NS = 3_000_000_000  # expires_ms
LINK_LOST = "link lost", 1, 1500, 0, 0.5


def play(cue, pulses, on_ms, off_ms, strength):
    """Here the motor would run; this one only prints. A new cue ends the one before."""
    pulse = f"{on_ms} ms on, {off_ms} ms off, strength {strength:g}"
    print(f"{cue}: {pulses} x {pulse}", flush=True)


class Session:
    """Which lines are obeyed: of one session until it is silent, and rising numbers only."""

    def __init__(self):
        self.newest = self.obeyed_ns = None

    def lives(self, now_ns):
        """Whether a line of the session was obeyed in the last 3 s."""
        return self.obeyed_ns is not None and now_ns - self.obeyed_ns <= SILENT_NS

    def obeys(self, session, sequence, now_ns):
        """Whether a line is obeyed; it then keeps its session, or begins it."""
        if self.lives(now_ns):
            ahead = sequence - self.newest[1]
            if session != self.newest[0] or not 0 < ahead <= MOST_AHEAD:
                return False
        self.newest, self.obeyed_ns = (session, sequence), now_ns
        return True


def whole(value, most):
    """A whole number from 0 on. Raises ValueError or TypeError."""
    if not isinstance(value, int) or isinstance(value, bool) or not 0 <= value <= most:
        raise ValueError("not a whole number from 0 on")
    return value


def flat(pairs):
    """An object: each key once, texts and finite numbers only. Raises ValueError or TypeError."""
    found = dict(pairs)
    if len(found) < len(pairs):
        raise ValueError("a key comes twice: two programs may take different values")
    for value in found.values():
        is_word = value is None or isinstance(value, str)
        if not is_word and not abs(value) <= sys.float_info.max:  # a list: TypeError
            raise ValueError("not a finite number")
    return found


def read(line):
    """((session, sequence), what to play), None for a line to skip."""
    try:
        cue = json.loads(line.decode(), object_pairs_hook=flat)
        numbers = tuple(whole(cue[k], 2**53 - 1) for k in ("session", "sequence"))
        pulses = whole(cue["pulses"], 10)
        on_ms, off_ms = (whole(cue[k], 60_000) for k in ("on_ms", "off_ms"))
        strength = cue["strength"]
        is_share = not isinstance(strength, bool) and 0 <= strength <= 1
        if not is_share or not cue["cue"].isprintable():
            return None
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None  # cut off on the way, forged, or something else
    return numbers, (cue["cue"][:40], pulses, on_ms, off_ms, strength)


def listen(where):
    """A socket at a path that only this user may write to, or at a port of this machine."""
    if where.isdecimal():
        receiver = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        receiver.bind(("127.0.0.1", int(where)))
        return receiver
    receiver = socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM)
    if os.path.exists(where):
        os.unlink(where)
    os.fchmod(receiver.fileno(), 0o600)  # before bind: never wider, whatever the umask
    receiver.bind(where)
    return receiver


def main(where):
    """Play each cue as it comes; where no line comes, the wearer must feel that too."""
    session, receiver = Session(), listen(where)
    receiver.settimeout(0.05)
    print("listening", flush=True)
    lost_ns = time.monotonic_ns() + SILENT_NS
    while True:
        try:
            line = receiver.recv(2048)
        except TimeoutError:
            line = b""
        now_ns = time.monotonic_ns()
        cue = read(line)
        if cue and session.obeys(*cue[0], now_ns):
            lost_ns = now_ns + SILENT_NS
            if cue[1][1]:  # pulses; else a sign of life
                play(*cue[1])
        elif now_ns >= lost_ns:  # also while others send
            lost_ns = now_ns + SILENT_NS
            play(*LINK_LOST)


if __name__ == "__main__":
    main(sys.argv[1])
