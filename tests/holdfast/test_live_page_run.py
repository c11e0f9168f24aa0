"""The live page beside the loop: it can never delay it, and each verb shows itself on it."""

from __future__ import annotations

import json
import re
import signal
import socket
import subprocess
from collections.abc import Callable, Iterator
from http.client import HTTPConnection
from typing import Any

import numpy as np
import pytest
from grip_bench import until
from hazard_marks import PAGE_DELAYS, STALE_PAGE
from live_bench import ROOT, RUN, Steady
from made_prediction import prediction
from page_bench import ABOUT, next_event

from holdfast.core.contract import Sample
from holdfast.core.errors import OutputError
from holdfast.core.source import SourceReading
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.monitor import GripMonitor
from holdfast.edge_runtime.wearer import Intent, IntentMonitor
from holdfast.live.grip import controller_for, open_grip
from holdfast.live.page.process import DIED
from holdfast.live.page.run_page import PageLink, RunPage, open_page
from holdfast.live.run import answer

VALID = np.ones(6, dtype=np.bool_)
READING = SourceReading(0, np.zeros(18), VALID, ("",) * 6)


@pytest.fixture
def ends() -> Iterator[tuple[socket.socket, socket.socket]]:
    """The loop's end of a link, and the page's."""
    ours, theirs = socket.socketpair(socket.AF_UNIX, socket.SOCK_SEQPACKET)
    with ours, theirs:
        yield ours, theirs


@pytest.fixture
def not_for_ever() -> Iterator[None]:
    """A call that waits ends the test, after a time that no machine needs."""
    before = signal.signal(signal.SIGALRM, _too_long)
    signal.alarm(120)
    yield
    signal.alarm(0)
    signal.signal(signal.SIGALRM, before)


def _too_long(number: int, frame: object) -> None:
    raise AssertionError("a call waited")


def received(end: socket.socket) -> list[dict[str, Any]]:
    """Every message that waits."""
    end.setblocking(False)
    messages = []
    while True:
        try:
            messages.append(json.loads(end.recv(1 << 20)))
        except BlockingIOError:
            return messages


# -- the link


@PAGE_DELAYS.mark
def test_a_page_that_takes_nothing_costs_its_messages_and_delays_none(
    ends, not_for_ever
):
    ours, theirs = ends
    link = PageLink(ours, print)
    taken = [link.send({"said": "x" * 500, "k": k}) for k in range(5000)]
    came = received(theirs)
    assert [one["k"] for one in came] == [k for k in range(5000) if taken[k]]
    assert 0 < len(came) < 5000
    assert link.unsent == 5000 - len(came)
    assert link.send({"k": "again"})
    assert received(theirs) == [{"k": "again"}]


@PAGE_DELAYS.mark
def test_a_page_whose_process_is_gone_is_reported_once(ends):
    ours, theirs = ends
    messages: list[str] = []
    link = PageLink(ours, messages.append)
    theirs.close()
    assert [link.send({"k": k}) for k in range(3)] == [False] * 3
    assert len(messages) == 1
    assert "the run goes on" in messages[0]


@PAGE_DELAYS.mark
def test_a_run_whose_page_takes_nothing_answers_every_sample(model, ends, not_for_ever):
    clock, link = VirtualClock(), PageLink(ends[0], print)
    page = RunPage(link, model.card)
    source = Steady(clock, 1500)
    summary = answer(source, model, clock, page.write, lambda: False)
    assert (summary.samples, summary.overruns) == (1500, 0)
    assert 0 < link.unsent < 1500


def test_the_page_gets_every_sample_its_answer_and_what_was_lost(model, ends):
    ours, theirs = ends
    page = RunPage(PageLink(ours, print), model.card)
    monitor = GripMonitor(model, None)
    for k in (0, 1, 5):
        sample = Sample(k * 6_666_667, np.full(18, 0.1 * k), VALID, k)
        page.write(monitor.feed(sample), sample, READING)
    samples = [one["sample"] for one in received(theirs)]
    assert [one["lost"] for one in samples] == [0, 0, 3]
    assert samples[2]["x"] == [0.5] * 18
    assert samples[0]["answer"]["state"] == "unknown"
    assert "grip" not in samples[0]


def test_the_page_learns_with_each_command_whether_it_leaves(model, ends, tmp_path):
    ours, theirs = ends
    clock = VirtualClock()
    control = controller_for("holdfast", model.card, print)
    url = f"unix://{tmp_path / 'nothing-here'}"
    grip = open_grip(url, control, 150.0, "", clock, print)
    page = RunPage(PageLink(ours, print), model.card, grip)
    monitor = GripMonitor(model, None)
    for k in range(2):
        sample = Sample(k * 6_666_667, np.full(18, 0.1 * k), VALID, k)
        said = monitor.feed(sample)
        grip.write(said, sample)
        page.write(said, sample, READING, grip.newest)
        until(lambda: not grip.leaves)
    grip.close()
    assert received(theirs)[-1]["sample"]["grip"]["leaves"] is False


def test_the_page_gets_the_wearers_own_command(model, ends):
    ours, theirs = ends
    page = RunPage(PageLink(ours, print), model.card)
    said: list[list[Intent]] = [[], [Intent(10**9, "close")]]
    page.intent = IntentMonitor(lambda: said.pop(0), lambda: 10**9, print)
    for _ in range(2):
        page.intent.look()
    page.write(prediction(), Sample(0, np.zeros(18), VALID, 0), READING)
    (shown,) = [one["sample"]["intent"] for one in received(theirs)]
    assert shown == {"wants": "close", "link": "live"}


# -- a process of its own


def ask(page: tuple[int, str], path: str) -> bytes:
    connection = HTTPConnection("127.0.0.1", page[0], timeout=300)
    connection.request("GET", page[1] + path)
    answer = connection.getresponse()
    content = answer.read()
    connection.close()
    return content


def page_in(line: str) -> tuple[int, str]:
    """Its port and its token."""
    found = re.search(r"live page: http://127\.0\.0\.1:(\d+)(/.{22})/$", line.strip())
    assert found
    return int(found[1]), found[2]


def test_the_page_ends_with_what_it_shows_and_its_port_is_free_again():
    lines: list[str] = []
    for address in ("0", None):
        address = address or str(page_in(lines[0])[0])
        link = open_page(address, ABOUT, lines.append)
        assert b"Holdfast live" in ask(page_in(lines[-1]), "/")
        assert link.send({"said": "begun"})
        process = link.process
        assert process is not None
        link.close("the run has ended")
        # a busy machine gives the process, which is nice, more time than a run waits for it
        process.wait(60.0)
        with pytest.raises(ConnectionRefusedError):
            ask(page_in(lines[-1]), "/")
    assert len(lines) == 2


def test_a_page_whose_process_does_not_start_is_an_error(monkeypatch):
    monkeypatch.setattr(
        "holdfast.live.page.run_page.PROCESS", "holdfast.no_such_module"
    )
    error = pytest.raises(
        OutputError, match=r"no process for the live page.*run without the page"
    )
    with error:
        open_page("0", ABOUT, print)


def close_stdin(run: subprocess.Popen[str]) -> None:
    assert run.stdin is not None
    run.stdin.close()


@STALE_PAGE.mark
@pytest.mark.parametrize(
    ("source", "end", "shown"),
    [
        ("virtual://ft232h", subprocess.Popen.kill, DIED),
        # its error stands on the terminal, which a person with the page may not see
        ("-", close_stdin, "the run failed: stdin: it ended before a sample came"),
    ],
)
def test_a_run_that_is_killed_or_fails_ends_its_page_with_the_reason(
    source: str, end: Callable[[subprocess.Popen[str]], None], shown: str
) -> None:
    command = [*RUN[:-1], source, "--to", "web:0"]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, cwd=ROOT, text=True, stdin=pipe, stderr=pipe) as run:
        assert run.stderr is not None
        page = page_in(next(line for line in run.stderr if "live page" in line))
        events = HTTPConnection("127.0.0.1", page[0], timeout=300)
        events.request("GET", page[1] + "/events")
        answer = events.getresponse()
        next_event(answer)
        end(run)
        while not (last := next_event(answer)[1])["ended"]:
            pass
        events.close()
    assert last["ended"].startswith(shown)
