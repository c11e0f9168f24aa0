"""The live page's server within the test, and its browsers of the standard library."""

from __future__ import annotations

import json
import socket
from collections.abc import Iterator
from contextlib import contextmanager
from http.client import HTTPConnection, HTTPResponse
from threading import Thread
from typing import Any

from holdfast.live.page.run_page import drawn_hand
from holdfast.live.page.server import LiveStream, PageServer

TOKEN = "a-token-of-the-test"
ABOUT = {
    "unit": "N",
    "hand": drawn_hand(None, 6),
    "model": "m.onnx",
    "source": "virtual://ft232h",
    "grip": False,
}
PERIOD_NS = 6_666_667


def sample(k: int, state: str = "grasp", **more: Any) -> dict[str, Any]:
    """The message of the k-th sample of a hand that holds 2 N a side with 0.6 N of load."""
    answer = {
        "state": state,
        "why": "",
        "p_risky": 0.25,
        "weight": "light",
        "latency_us": 900.0,
    }
    answer |= {"arm": False, "act": False, "opening": False, "overridden": False}
    answer |= {
        "commands": "none",
        "late": False,
        "started_loaded": None,
        "degraded": False,
    }
    forces = [0.1 + 1e-9 * k, 0.0, 2.0 / 3.0] * 6
    grip = {"mode": "tighten", "target_n": 9.4, "reason": "risky slip", "leaves": True}
    grip |= {"mu_hat": None, "margin": None, "needed_n": None}
    message = {"t_ns": 5_000_000_000 + k * PERIOD_NS, "x": forces, "v": [1] * 6}
    message |= {"why": [""] * 6, "lost": 0, "unsent": 0, "answer": answer, "grip": grip}
    return {"sample": message | more}


class Served:
    """A stream of samples behind a server."""

    def __init__(self, **about: Any) -> None:
        self.stream = LiveStream(ABOUT | about)
        listener = socket.create_server(("127.0.0.1", 0))
        self.port: int = listener.getsockname()[1]
        self.url = f"http://127.0.0.1:{self.port}/{TOKEN}/"
        self.server = PageServer(listener, self.stream, TOKEN)
        Thread(target=self.server.serve_forever, kwargs={"poll_interval": 0.02}).start()

    def frame(self, *messages: dict[str, Any], now_s: float = 0.0) -> None:
        """Take these messages and publish them."""
        for message in messages:
            self.stream.take(message, now_s)
        self.stream.publish(now_s)

    def ask(self, path: str, token: str = f"/{TOKEN}") -> tuple[int, bytes, Any]:
        """(status, content, headers) of a request."""
        answer = self.begin(path, token)
        with answer:
            return answer.status, answer.read(), answer.headers

    def begin(self, path: str, token: str = f"/{TOKEN}") -> HTTPResponse:
        """A request whose answer has begun."""
        connection = HTTPConnection("127.0.0.1", self.port, timeout=300)
        connection.request("GET", token + path)
        answer = connection.getresponse()
        connection.close()  # the answer keeps the socket
        return answer


@contextmanager
def served(**about: Any) -> Iterator[Served]:
    one = Served(**about)
    try:
        yield one
    finally:
        one.frame({"end": "the test has ended"})
        one.server.shutdown()
        one.server.server_close()


def next_event(answer: HTTPResponse) -> tuple[str, dict[str, Any]]:
    """The next server-sent event: its name and content; b"" at the end of the stream."""
    name = ""
    for line in answer:
        if line.startswith(b"event: "):
            name = line[7:].decode().strip()
        if line.startswith(b"data: "):
            return name, dict(json.loads(line[6:]))
    raise EOFError
