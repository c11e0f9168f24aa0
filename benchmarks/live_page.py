"""Whether the live page delays the loop: `holdfast run --web` beside browsers that stall and read.

Runs on the virtual hand in real time, one after
another. A stalled browser asks for the events and never reads; its buffers are small, so the
server's are soon full. Where the server disconnects it, it comes back at once. Counts and latencies
are those of the run's own summary: times on this machine, of simulated samples.
"""

from __future__ import annotations

import re
import select
import socket
import subprocess
import sys
from dataclasses import asdict, dataclass
from pathlib import Path
from threading import Event, Thread
from typing import IO

from holdfast.core.errors import OutputError
from holdfast.core.reading import Json

ROOT = Path(__file__).resolve().parent.parent
MODEL = ROOT / "models" / "holdfast-150hz.onnx"
SECONDS = 20.0
TURNS = 3
SMALL_BUFFER = 2048
REQUEST = b"GET /events HTTP/1.0\r\nHost: 127.0.0.1\r\n\r\n"
POLL_MS = 50
ADDRESS = re.compile(r"live page: http://127\.0\.0\.1:(\d+)/")
COUNTS = re.compile(r"^(\d+) samples, (\d+) overruns", re.MULTILINE)
_TIMES = r" +p50 +([\d.]+) us +p99 +[\d.]+ us +p99\.9 +([\d.]+) us"
EMIT, WHOLE = (
    re.compile(f"^{name}{_TIMES}", re.MULTILINE) for name in ("emit", "read to emit")
)


@dataclass(frozen=True)
class Case:
    """How a run is watched: without a page, or by browsers that stall and that read."""

    name: str
    page: bool = True
    stalled: int = 0
    reading: int = 0


CASES = (
    Case("no page", page=False),
    Case("page, no browser"),
    Case("20 stalled browsers", stalled=20),
    Case("20 stalled, 3 reading", stalled=20, reading=3),
)


@dataclass(frozen=True)
class PageLoad:
    """One run. latency: from reading to passing on. emit: passing an answer on, to the page too.

    disconnects: of stalled browsers. frames_per_s: that a reading browser got.
    """

    case: str
    samples: int
    overruns: int
    latency_p50_us: float
    latency_p999_us: float
    emit_p50_us: float
    emit_p999_us: float
    disconnects: int
    frames_per_s: float | None


class Browsers:
    """Browsers of a page on a port, in threads, until `stop`."""

    def __init__(self, port: int, case: Case) -> None:
        self.disconnects = self.frames = 0
        self._port = port
        self._done = Event()
        self._threads = [Thread(target=self._stall, args=(case.stalled,))]
        self._threads += [Thread(target=self._read) for _ in range(case.reading)]
        for one in self._threads:
            one.start()

    def stop(self) -> None:
        """Close them all."""
        self._done.set()
        for one in self._threads:
            one.join()

    def _stall(self, count: int) -> None:
        waiting = select.poll()
        open_ones = {}
        for _ in range(count):
            browser = self._asked()
            open_ones[browser.fileno()] = browser
            waiting.register(browser, select.POLLRDHUP)
        while not self._done.is_set():
            for handle, _ in waiting.poll(POLL_MS):
                waiting.unregister(handle)
                open_ones.pop(handle).close()
                self.disconnects += 1
                try:
                    browser = self._asked()
                except OSError:  # the run has ended
                    continue
                open_ones[browser.fileno()] = browser
                waiting.register(browser, select.POLLRDHUP)
        for browser in open_ones.values():
            browser.close()

    def _asked(self) -> socket.socket:
        browser = socket.socket()
        browser.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, SMALL_BUFFER)
        browser.connect(("127.0.0.1", self._port))
        browser.sendall(REQUEST)
        return browser

    def _read(self) -> None:
        with socket.create_connection(("127.0.0.1", self._port)) as browser:
            browser.sendall(REQUEST)
            while not self._done.is_set() and (data := browser.recv(1 << 16)):
                self.frames += data.count(b"event: frame")


def watched_run(case: Case, seconds: float) -> PageLoad:
    """A run of so many seconds on the virtual hand, watched as the case says.

    It writes nothing but its summary: a file's thread would share the loop's process.
    """
    words = ["run", str(MODEL), "--source", "virtual://ft232h", "--quiet"]
    words += ["--seconds", f"{seconds:g}", *(["--web", "0"] if case.page else [])]
    command = [sys.executable, "-m", "holdfast", *words]
    with subprocess.Popen(command, cwd=ROOT, text=True, stderr=subprocess.PIPE) as run:
        assert run.stderr is not None
        browsers = Browsers(_port(run.stderr), case) if case.page else None
        said = run.stderr.read()
        run.wait()
        if browsers is not None:
            browsers.stop()
    return _figures(case, seconds, said, browsers)


def _port(messages: IO[str]) -> int:
    return next(int(found[1]) for line in messages if (found := ADDRESS.match(line)))


def _figures(
    case: Case, seconds: float, said: str, browsers: Browsers | None
) -> PageLoad:
    counts = COUNTS.search(said)
    whole = WHOLE.search(said)
    emit = EMIT.search(said)
    if counts is None or whole is None or emit is None:
        raise OutputError("the run has no summary", where=case.name, cause=said[-500:])
    return PageLoad(
        case=case.name,
        samples=int(counts[1]),
        overruns=int(counts[2]),
        latency_p50_us=float(whole[1]),
        latency_p999_us=float(whole[2]),
        emit_p50_us=float(emit[1]),
        emit_p999_us=float(emit[2]),
        disconnects=browsers.disconnects if browsers else 0,
        frames_per_s=browsers.frames / case.reading / seconds
        if browsers and case.reading
        else None,
    )


def measure(seconds: float = SECONDS, turns: int = TURNS) -> Json:
    """All cases, interleaved; rows in the order of the runs."""
    rows = [watched_run(case, seconds) for _ in range(turns) for case in CASES]
    return {
        "seconds": seconds,
        "rows": [asdict(row) for row in rows],
    }
