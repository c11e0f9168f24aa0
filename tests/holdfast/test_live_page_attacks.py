"""Slow, huge and many requests to the live page: a browser still gets in, and memory stays."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from http.client import HTTPConnection, HTTPResponse
from itertools import count
from pathlib import Path

import pytest
from hazard_marks import CROWDED_PAGE
from page_bench import ABOUT, Served, next_event, served

from holdfast.live.page.link import open_page
from holdfast.live.page.server import (
    MOST_CONNECTIONS,
    MOST_HEAD_BYTES,
    MOST_OF_ADDRESS,
    REQUEST_S,
    Visitors,
    read_head,
)

WHOLE = b"GET / HTTP/1.1\r\nHost: localhost\r\n\r\n"
SLOW, HUGE = 100, 60
"""Connections that never send a whole request: more than there is room for; and those that send
much."""
HUGE_HEADERS = b"".join(b"X-%d: %s\r\n" % (k, b"x" * 60_000) for k in range(90))
"""Each within the limits of Python's http.client: 100 lines of 64 KiB."""


@contextmanager
def slow_sockets(
    port: int, sent: bytes, number: int = SLOW
) -> Iterator[list[socket.socket]]:
    with ExitStack() as stack:
        opened = []
        for _ in range(number):
            one = socket.create_connection(("127.0.0.1", port))
            opened.append(stack.enter_context(one))
            one.sendall(sent)
        yield opened


@contextmanager
def pair() -> Iterator[tuple[socket.socket, socket.socket]]:
    ours, theirs = socket.socketpair()
    with ours, theirs:
        yield ours, theirs


def shut(connection: socket.socket) -> bool:
    """Whether the server ended a connection whose other end this process has."""
    connection.setblocking(False)
    try:
        return connection.recv(1) == b""
    except BlockingIOError:
        return False


# -- in time


@CROWDED_PAGE.mark
@pytest.mark.parametrize("sent", [b"", b"GET / HT", b"GET / HTTP/1.1\r\nHost: loc"])
def test_a_browser_gets_in_beside_sockets_that_never_send_a_whole_request(sent):
    with served() as page, slow_sockets(page.port, sent):
        assert [page.ask("/")[0] for _ in range(3)] == [200] * 3


@CROWDED_PAGE.mark
def test_a_request_that_comes_byte_by_byte_ends_at_its_time_and_not_with_its_bytes():
    with pair() as (browser, server):
        browser.sendall(WHOLE)
        clock_s = count(0.0, 0.3 * REQUEST_S).__next__
        with OneByteAtATime(server) as one_byte, pytest.raises(TimeoutError):
            read_head(one_byte, clock_s)
        assert one_byte.taken == 3
        # each wait is for what is left of the whole time
        assert one_byte.waits_s == pytest.approx(
            [0.7 * REQUEST_S, 0.4 * REQUEST_S, 0.1 * REQUEST_S]
        )


class OneByteAtATime(socket.socket):
    """A connection on which every read gives one byte."""

    def __init__(self, connection: socket.socket) -> None:
        super().__init__(fileno=connection.detach())
        self.taken = 0
        self.waits_s: list[float] = []

    def settimeout(self, value: float | None) -> None:
        assert value is not None
        self.waits_s.append(value)
        super().settimeout(value)

    def recv(self, bufsize: int, flags: int = 0) -> bytes:
        self.taken += 1
        return super().recv(1, flags)


def test_a_whole_request_is_read_however_it_is_cut():
    with pair() as (browser, server):
        browser.sendall(WHOLE + b"body")
        with OneByteAtATime(server) as one_byte:
            assert read_head(one_byte, lambda: 0.0) == WHOLE


# -- in size


@CROWDED_PAGE.mark
def test_headers_that_are_too_long_are_answered_before_they_end():
    head = WHOLE[:-2] + b"Cookie: "
    with (
        served() as page,
        socket.create_connection(("127.0.0.1", page.port), timeout=300) as browser,
    ):
        browser.sendall(head + b"x" * (MOST_HEAD_BYTES + 1 - len(head)))
        assert browser.recv(100).startswith(b"HTTP/1.0 431 ")


def test_the_longest_request_that_is_allowed_is_answered():
    head = WHOLE[:-2] + b"Cookie: "
    with served() as page:
        length = MOST_HEAD_BYTES - len(head) - 4
        with socket.create_connection(("127.0.0.1", page.port), timeout=300) as browser:
            browser.sendall(head + b"x" * length + b"\r\n\r\n")
            assert browser.recv(100).startswith(b"HTTP/1.0 200 ")


def resident_mb(pid: int) -> float:
    """The most memory that a process has had so far."""
    status = Path(f"/proc/{pid}/status").read_text("ascii")
    line = next(line for line in status.splitlines() if line.startswith("VmHWM"))
    return int(line.split()[1]) / 1024


@CROWDED_PAGE.mark
def test_the_page_s_process_keeps_its_memory_under_huge_headers():
    reported: list[str] = []
    link = open_page("0", ABOUT, reported.append)
    process = link._process
    assert process is not None
    try:
        port = int(reported[0].rstrip("/").rpartition(":")[2])
        before_mb = resident_mb(process.pid)
        start = WHOLE[:-2]
        with slow_sockets(port, start, HUGE) as opened:
            for one in opened:
                one.setblocking(False)
                # the server ends most of them before all is sent
                with suppress(OSError):
                    one.sendall(HUGE_HEADERS)
            browser = HTTPConnection("127.0.0.1", port, timeout=300)
            browser.request("GET", "/")
            assert browser.getresponse().status == 200
            browser.close()
        grown_mb = resident_mb(process.pid) - before_mb
    finally:
        link.close("the test has ended")
        # a busy machine gives the process, which is nice, more time than a run waits for it
        process.wait(60.0)
    assert grown_mb < 16.0


# -- in number


@CROWDED_PAGE.mark
def test_a_browser_elsewhere_keeps_its_place_whatever_an_address_opens():
    with ExitStack() as stack:
        visitors = Visitors()

        def enter(address: str, *, asks: bool) -> socket.socket:
            """The browser's end of a new connection."""
            ours, theirs = stack.enter_context(pair())
            if not visitors.enter(theirs, address):
                theirs.shutdown(socket.SHUT_RDWR)
            if asks:
                visitors.ask(theirs)
            return ours

        genuine = [enter("192.0.2.1", asks=True) for _ in range(6)]
        for _ in range(3 * MOST_OF_ADDRESS):
            enter("192.0.2.2", asks=True)
        for k in range(2 * MOST_CONNECTIONS):
            enter(f"198.51.100.{k}", asks=False)
        late = enter("192.0.2.1", asks=True)
        assert not any(map(shut, [*genuine, late]))


def test_where_all_have_asked_a_new_address_is_closed_at_once():
    with ExitStack() as stack:
        visitors = Visitors()
        for k in range(MOST_CONNECTIONS):
            _, theirs = stack.enter_context(pair())
            assert visitors.enter(theirs, f"198.51.100.{k}")
            visitors.ask(theirs)
        _, theirs = stack.enter_context(pair())
        assert not visitors.enter(theirs, "192.0.2.1")


def test_streams_of_one_address_are_limited_and_the_newest_stays():
    with served() as page, ExitStack() as stack:
        streams = [
            stack.enter_context(page.begin("/events"))
            for _ in range(MOST_OF_ADDRESS + 1)
        ]
        next_event(streams[-1])
        page.frame({"said": "a"})
        assert next_event(streams[-1])[1]["said"] == ["a"]
        next_event(streams[0])
        with pytest.raises((EOFError, ConnectionError)):
            read_on(page, streams[0])


def read_on(page: Served, stream: HTTPResponse) -> None:
    """Read frames until the server ends the stream, or goes on with it."""
    for _ in range(50):
        page.frame({"said": "on"})
        next_event(stream)


def test_a_connection_that_has_left_makes_room():
    with served() as page:
        for _ in range(3 * MOST_CONNECTIONS):
            assert page.ask("/page.css")[0] == 200
