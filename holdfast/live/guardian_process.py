"""The child process that speaks when its parent dies: standard library only, run as a script.

It holds the parent's socket or serial port, and waits for the parent's messages on a socket pair:

    b"fresh"            with a descriptor: hold this one from now on
    b"release"          let go of it: a serial adapter that was unplugged gets another name as long
                        as it is held
    b"goodbye"          the parent has written its last line itself: end
    end of file         the parent is dead (kill -9, out of memory, a crash): write the last line

The line's sequence is one above that in the memory which both share. The memory also holds the key
of a link whose lines are sealed (core/line_key.py), with zeros after it, which HMAC ignores.

    guardian_process.py CONTROL_FD MEMORY_FD TEXT_WITH_%(sequence)d_AND_%(t_ns)d [LINK_OF_THE_KEY]
"""

from __future__ import annotations

import importlib
import mmap
import os
import select
import signal
import socket
import struct
import sys
import time

READY = b"ready"
FRESH = b"fresh"
RELEASE = b"release"
GOODBYE = b"goodbye"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT, signal.SIGABRT)
"""Ignored: they are sent to a whole terminal or service (systemd's watchdog: SIGABRT)."""
SEQUENCE_BYTES, MEMORY_BYTES = 8, 8 + 64
"""The sequence, and behind it the key."""
TRIES, WAIT_MS = 10, 500
"""How often and how long the last line waits for room in a serial port."""


def main(control_fd: int, memory_fd: int, text: str, link: str | None = None) -> None:
    """Wait for the parent's end; write the text where it came without a goodbye."""
    # now, and only for a sealed line: at the end there may be no memory left for a library
    seal = None if link is None else importlib.import_module("hmac")
    for number in SIGNALS:
        signal.signal(number, signal.SIG_IGN)
    control = socket.socket(fileno=control_fd)
    memory = mmap.mmap(memory_fd, MEMORY_BYTES, prot=mmap.PROT_READ)
    control.send(READY)
    # it sleeps in this call for the whole run, and costs the loop nothing
    held = _wait_for_the_end(control)
    if held is not None:
        # the newest sequence number stands in shared memory, which outlives the parent
        sequence = struct.unpack("q", memory[:SEQUENCE_BYTES])[0] + 1
        # the same clock as the run's, so that the last line fits those before it
        clock = getattr(time, "CLOCK_BOOTTIME", time.CLOCK_MONOTONIC)
        t_ns = time.clock_gettime_ns(clock)
        line = text % {"sequence": sequence, "t_ns": t_ns}
        if seal is not None:
            before, _, end = line.rpartition("}")
            named = f"{link}\n{before.lstrip()}".encode()
            code = seal.digest(memory[SEQUENCE_BYTES:], named, "sha256").hex()
            line = f'{before},"mac":"{code}"}}{end}'
        _write(held, line.encode())


def _wait_for_the_end(control: socket.socket) -> int | None:
    """The descriptor to write to, or None after a goodbye."""
    held: int | None = None
    while True:
        try:
            message, fresh, _, _ = socket.recv_fds(control, 16, 1)
        except ConnectionResetError:
            # the parent died before it read our "ready"
            message = b""
            fresh = []
        if message in (FRESH, RELEASE):
            # two descriptors of one adapter would keep its old name in use
            if held is not None:
                os.close(held)
            held = fresh[0] if fresh else None
        # the parent's own last line must stay the last one
        if message == GOODBYE:
            return None
        if not message:
            return held


def _write(held: int, data: bytes) -> None:
    for _ in range(TRIES):
        try:
            # a port may take a part: the rest follows, so that the line arrives whole
            taken = os.write(held, data)
            data = data[taken:]
        except BlockingIOError:
            # it may wait here: no loop runs any more
            ready = select.poll()
            ready.register(held, select.POLLOUT)
            ready.poll(WAIT_MS)
        except ConnectionRefusedError:
            # an old error of the socket; the next write is sent
            continue
        except OSError:
            return
        if not data:
            return


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), *sys.argv[3:])
