"""The process that serves the live page: the standard library only, started by link.py.

    python -m holdfast.live_page.process LISTENER_FD LINK_FD

It takes every message of the run at once and keeps the last 30 s, so that the socket between both
stays empty. It ends when the run does, however that ends.
"""

from __future__ import annotations

import json
import os
import select
import signal
import socket
import sys
import time
from contextlib import suppress
from threading import Thread

from holdfast.live_page.server import Access, PageServer
from holdfast.live_page.stream import FRAME_S, LiveStream

LARGEST_MESSAGE = 1 << 20
NICENESS = 10
"""The loop comes first, where both share a core."""
LAST_FRAME_S = 0.1
"""So long the browsers' threads have for the last frame."""
READY = b"ready"
DIED = "the program that ran the loop died"


def main(listener_fd: int, link_fd: int) -> None:
    """Serve until the run has ended. A Ctrl-C is for the run, which then ends this process."""
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)
    link = socket.socket(fileno=link_fd)
    first = json.loads(link.recv(LARGEST_MESSAGE))
    stream = LiveStream(first["about"])
    server = PageServer(
        socket.socket(fileno=listener_fd),
        stream,
        Access(first["access"]["token"], tuple(first["access"]["hosts"])),
        lambda action: _pass_on(link, action),
    )
    Thread(target=server.serve_forever, name="live page", daemon=True).start()
    link.send(READY)
    follow(link, stream)
    time.sleep(LAST_FRAME_S)


def follow(link: socket.socket, stream: LiveStream) -> None:
    """Take every message, and publish a frame at most every FRAME_S, until the run has ended."""
    due_s = time.monotonic()
    while not stream.ended:
        wait_s = max(0.0, due_s - time.monotonic())
        if select.select([link], [], [], wait_s)[0]:
            stream.take(_received(link), time.monotonic())
        if time.monotonic() >= due_s or stream.ended:
            stream.publish(time.monotonic())
            due_s = time.monotonic() + FRAME_S


def _received(link: socket.socket) -> dict[str, object]:
    """The next message; where the run is gone, one that says so."""
    with suppress(OSError):
        data = link.recv(LARGEST_MESSAGE)
        if data:
            message: dict[str, object] = json.loads(data)
            return message
    return {"end": DIED}


def _pass_on(link: socket.socket, action: bytes) -> bool:
    """Send an action to the run; False where it has no room for one."""
    try:
        return link.send(action, socket.MSG_DONTWAIT) > 0
    except OSError:
        return False


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
