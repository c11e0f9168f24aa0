"""The process that serves the live page: the standard library only, started by run_page.py.

    python -m holdfast.live.page.process LISTENER_FD LINK_FD

It takes the messages of the run. It ends when the run ends, or dies.
"""

from __future__ import annotations

import json
import os
import signal
import socket
import sys
import time
from collections.abc import Iterator
from threading import Thread

from holdfast.live.page.server import FRAME_S, LiveStream, Message, PageServer

LARGEST_MESSAGE = 1 << 20
NICENESS = 10
"""The loop comes first, where both share a core."""
LAST_FRAME_S = 0.1
"""So long the browsers' threads have for the last frame."""
READY = b"ready"
DIED = "the program that ran the loop died"


def main(listener_fd: int, link_fd: int) -> None:
    """Serve until the run has ended. A Ctrl-C is for the run, which then ends this process."""
    # a signal of the terminal is for the run, which ends this process by its link
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP, signal.SIGQUIT):
        signal.signal(number, signal.SIG_IGN)
    os.nice(NICENESS)

    link = socket.socket(fileno=link_fd)
    listener = socket.socket(fileno=listener_fd)
    first = json.loads(link.recv(LARGEST_MESSAGE))
    stream = LiveStream(first["about"])
    # the token comes by the link: on the command line every user of the machine could read it
    server = PageServer(listener, stream, first["token"])

    Thread(target=server.serve_forever, name="live page", daemon=True).start()
    link.send(READY)
    follow(link, stream)
    time.sleep(LAST_FRAME_S)


def follow(link: socket.socket, stream: LiveStream) -> None:
    """Every FRAME_S take all messages and publish a frame, until the run has ended.

    It sleeps in between, and does not wait for a message: to wake it would cost the loop time at
    every sample.
    """
    link.setblocking(False)
    while not stream.ended:
        time.sleep(FRAME_S)
        for message in _waiting(link):
            stream.take(message, time.monotonic())
        # one frame for all messages of this time, also where none came: it shows the silence
        stream.publish(time.monotonic())


def _waiting(link: socket.socket) -> Iterator[Message]:
    """All messages that wait; where the run is gone, one that says so."""
    while True:
        try:
            data = link.recv(LARGEST_MESSAGE)
        except BlockingIOError:
            return
        # an end without an `end` message: the run died
        if not data:
            yield {"end": DIED}
            return
        yield json.loads(data)


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]))
