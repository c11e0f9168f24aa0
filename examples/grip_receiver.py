"""A hand's own controller: receives the commands of `holdfast run --grip URL`.

python examples/grip_receiver.py /run/hand/grip       --grip unix:///run/hand/grip
python examples/grip_receiver.py 9000                 --grip udp://127.0.0.1:9000
python examples/grip_receiver.py 9000 link.key        --grip "udp://127.0.0.1:9000?key=link.key"
"""

import hmac
import json
import os
import socket
import sys
import time

RATE_HZ = 150  # of the model: at most a second of samples ahead
SILENT_NS = 300_000_000  # expires_ms
CEILING_N, SLEW_N_S = 70.0, 400.0  # what this hand allows, whatever is commanded
MODES = "idle", "hold", "tighten", "relax", "yield"


def move(mode, target_n, slew_n_s, reason):
    """Here the motor would be moved; this hand only prints."""
    grip = "the grip it has" if target_n is None else f"{target_n:.1f} N"
    print(f"{mode}: {grip}, at most {slew_n_s:.0f} N/s ({reason})", flush=True)


class Session:
    """Which lines are obeyed: of one session until it is silent, and rising numbers only."""

    def __init__(self, after=None):
        self.newest = after  # with a key: nothing up to this (session, sequence) again
        self.keyed = after is not None
        self.obeyed_ns = None

    def lives(self, now_ns):
        """Whether a line of the session was obeyed in the last 300 ms."""
        return self.obeyed_ns is not None and now_ns - self.obeyed_ns <= SILENT_NS

    def obeys(self, session, sequence, now_ns):
        """Whether a line is obeyed; it then keeps its session, or begins it."""
        if self.lives(now_ns):
            ahead = sequence - self.newest[1]
            fits = session == self.newest[0] and 0 < ahead <= RATE_HZ
        else:
            fits = not self.keyed or (session, sequence) > self.newest
        if fits:
            self.newest, self.obeyed_ns = (session, sequence), now_ns
        return fits


def number(value, most=sys.float_info.max):
    """A finite number from 0 on. Raises ValueError or TypeError."""
    if (
        isinstance(value, bool) or not 0 <= value <= most
    ):  # not a number: neither is true
        raise ValueError("not a number from 0 on")
    return value


def whole(value):
    """The number of a session or of a line. Raises ValueError or TypeError."""
    if not isinstance(value, int):
        raise TypeError("not a whole number")
    return number(value, 2**53 - 1)


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


def opened(line, key):
    """A sealed line without its code. Raises ValueError."""
    line, _, code = line.rpartition(b',"mac":"')
    right = hmac.digest(key, b"grip\n" + line, "sha256").hex().encode() + b'"}'
    if not hmac.compare_digest(right, code):
        raise ValueError("not sealed with this key")
    return line + b"}"


def read(line, key):
    """((session, sequence), (mode, target_n, slew_n_s, reason)), None for a line to skip."""
    try:
        text = (opened(line, key) if key else line).decode()
        command = json.loads(text, object_pairs_hook=flat)
        numbers = whole(command["session"]), whole(command["sequence"])
        mode, reason, target_n = (command[k] for k in ("mode", "reason", "target_n"))
        if mode not in MODES or not reason.isprintable():
            return None
        if target_n is not None:
            target_n = min(number(target_n), CEILING_N)
        slew_n_s = min(number(command["slew_n_s"]), SLEW_N_S)
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError):
        return None  # cut off on the way, forged, or something else
    return numbers, (mode, target_n, slew_n_s, reason[:40])


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


def main(where, key_path=None):
    """Obey one session; hold where none of its commands has come for 300 ms."""
    key, seen = None, None
    if key_path:
        with open(key_path, encoding="ascii") as file:
            key = file.read().strip().encode()
        seen = f"{key_path}.grip.seen"  # the newest session outlives this program
    session = Session((stored(seen), -1) if seen else None)
    receiver = listen(where)
    receiver.settimeout(0.05)
    print("listening", flush=True)
    holds = True
    while True:
        try:
            line = receiver.recv(2048)
        except TimeoutError:
            line = b""
        now_ns = time.monotonic_ns()
        if not holds and not session.lives(now_ns):  # also while others send
            move("hold", None, 0.0, "no command for 300 ms")
            holds = True
        before = session.newest
        command = read(line, key)
        if command and session.obeys(*command[0], now_ns):
            if seen and session.newest[0] != before[0]:
                store(seen, session.newest[0])
            move(*command[1])
            holds = False


def stored(path):
    """The newest session that was ever obeyed, 0 for none."""
    if not os.path.exists(path):
        return 0
    with open(path, encoding="ascii") as file:
        return int(file.read())


def store(path, session):
    """Keep its number where a restart finds it."""
    with open(path + ".new", "w", encoding="ascii") as file:
        file.write(str(session))
    os.replace(path + ".new", path)


if __name__ == "__main__":
    main(*sys.argv[1:])
