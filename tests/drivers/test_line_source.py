"""Lines as a live source: stamps, silence, what comes too fast, and where the bytes come from."""

from __future__ import annotations

import fcntl
import json
import math
import os
import re
import select
import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack, closing, suppress
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from grip_bench import TtyReceiver
from hazard_marks import STALE_LINES
from hypothesis import given
from hypothesis import strategies as st
from live_bench import go

from holdfast.core.contract import Prediction, channel_names
from holdfast.core.errors import AccessDenied, DeviceNotFound, RateError, UsageError
from holdfast.core.hand_lines import LONGEST_LINE, SECOND_NS
from holdfast.core.source import Source, SourceReading
from holdfast.drivers.arrivals import LOST, SKIPPED
from holdfast.drivers.line_feeds import (
    DatagramFeed,
    LineSplitter,
    SerialFeed,
    StreamFeed,
    close_port,
    open_port,
)
from holdfast.drivers.lines import LineSource, SampleReader
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.model import Model
from holdfast.live.running import RunClock
from holdfast.live.sources import open_live

PERIOD_NS = round(1e9 / 150)
NAMES = channel_names(6)
AHEAD_NS = 77 * 10**9
"""The sender's clock over this machine's."""
RATE_HZ = 150.0


def text_of(k: int, **more: Any) -> bytes:
    """Line k of a sender: one line is unlike any other."""
    values = 0.02 * np.random.default_rng(k).normal(size=18)
    fields = dict(zip(NAMES, values.tolist(), strict=True))
    return json.dumps(fields | {"n": k} | more).encode()


class ScriptedFeed(StreamFeed):
    """Line k is sent at (k + 0.5) periods and arrives after late_ns(k); None: never. The feed ends
    after `ends` lines."""

    name = "script"

    def __init__(
        self,
        clock: VirtualClock,
        late_ns: Callable[[int], int | None] = lambda k: 0,
        line: Callable[[int], bytes] = lambda k: text_of(
            k, t_ns=AHEAD_NS + round((k + 0.5) * PERIOD_NS)
        ),
        ends: int = 10**9,
        rubbish: bytes = b"",
        bytes_per_s: float | None = None,
    ) -> None:
        self.bytes_per_s, self._lines = bytes_per_s, LineSplitter()
        self.clock, self.line, self.ends = clock, line, ends
        self.rubbish = rubbish
        self.late_ns = late_ns
        self.ended = False
        self.next = 0

    def arrives_ns(self, k: int) -> int:
        late = self.late_ns(k)
        return 1 << 62 if late is None else round((k + 0.5) * PERIOD_NS) + late

    def pull(self, timeout_s: float) -> list[bytes]:
        until_ns = self.clock.now_ns() + round(1e9 * timeout_s)
        while self.next < self.ends and self.late_ns(self.next) is None:
            self.next += 1
        if self.next >= self.ends:
            self.ended = True
            return []
        if self.arrives_ns(self.next) > until_ns:
            self.clock.wait_until(until_ns)
            return []
        self.clock.wait_until(self.arrives_ns(self.next))
        came: list[bytes] = []
        while (
            self.next < self.ends and self.arrives_ns(self.next) <= self.clock.now_ns()
        ):
            came.append(self.line(self.next))
            if self.rubbish and self.next % 5 == 1:
                came.append(self.rubbish)
            self.next += 1
        return came

    def close(self) -> None:
        self.ended = True


def opened(
    clock: VirtualClock,
    rate_hz: float | None = RATE_HZ,
    **script: Any,
) -> tuple[LineSource, ScriptedFeed, list[str]]:
    said: list[str] = []
    feed = ScriptedFeed(clock, **script)
    source = LineSource(feed, SampleReader(), clock, said.append, rate_hz)
    return source, feed, said


def read(source: Source) -> SourceReading:
    reading = source.read()
    assert reading is not None
    return reading


def answered(
    model: Model, clock: VirtualClock, source: LineSource, periods: int
) -> list[Prediction]:
    _, answers, _ = go(
        model, source, clock, stopped=lambda: clock.now_ns() > periods * PERIOD_NS
    )
    return answers


def test_every_line_is_read_once_at_its_arrival() -> None:
    clock = VirtualClock()
    source, feed, said = opened(clock, late_ns=lambda k: 2_000_000)
    for k in range(50):
        reading = read(source)
        assert reading.t_ns == feed.arrives_ns(k) == clock.now_ns()
        values = json.loads(feed.line(k))
        assert reading.values.tolist() == [values[name] for name in NAMES]
    assert (source.unit, source.n_channels, source.rate_hz) == ("N", 18, 150.0)
    assert said == ["script: 6 sensors in N at 150 Hz, stamps of arrival"]


@STALE_LINES.mark
def test_a_silent_sender_is_unknown_and_comes_back(model: Model) -> None:
    clock = VirtualClock()
    gap = range(300, 450)
    source, _, _ = opened(clock, late_ns=lambda k: None if k in gap else 0)
    answers = answered(model, clock, source, 620)
    at = [round(one.t_decided_ns / PERIOD_NS - 0.5) for one in answers]
    states = dict(zip(at, (one.state for one in answers), strict=True))
    assert {states[k] for k in at if 150 < k < 300} == {"nothing"}
    assert {states[k] for k in at if 304 < k < 450} == {"unknown"}
    # one answer a period, also while nothing comes
    assert len([k for k in at if 304 < k < 450]) in range(140, 150)
    assert states[max(at)] == "nothing"


@STALE_LINES.mark
def test_a_stuck_sender_is_unknown(model: Model) -> None:
    clock = VirtualClock()
    source, _, _ = opened(
        clock, line=lambda k: text_of(min(k, 200), t_ns=k * PERIOD_NS)
    )
    answers = answered(model, clock, source, 600)
    assert {one.why for one in answers if one.t_decided_ns > 320 * PERIOD_NS} == {
        "repeats"
    }


def test_a_finger_that_sends_nan_is_lost_alone(model: Model) -> None:
    """The sender writes its lines with json.dumps."""
    clock = VirtualClock()
    source, _, said = opened(
        clock, line=lambda k: text_of(k, **({"Z4": math.nan} if k >= 200 else {}))
    )
    answers = answered(model, clock, source, 400)
    assert {one.state for one in answers[150:]} == {"nothing"}
    degraded = [one.degraded for one in answers]
    assert degraded[:200] == [False] * 200
    assert set(degraded[200:]) == {True}
    source.close()
    assert said == ["script: 6 sensors in N at 150 Hz, stamps of arrival"]


@STALE_LINES.mark
def test_what_waited_while_nothing_was_read_is_dropped() -> None:
    """As between two trials: a sender that died meanwhile must not leave one fresh sample."""
    clock = VirtualClock()
    source, feed, said = opened(clock, ends=200)
    for _ in range(50):
        read(source)
    clock.wait_until(190 * PERIOD_NS)
    reading = read(source)
    assert reading.valid.all()
    assert reading.t_ns > 190 * PERIOD_NS
    clock.wait_until(230 * PERIOD_NS)
    assert source.read() is None
    assert feed.ended
    # lines 50 to 189, then within the same second 191 to 199
    source.close()
    assert said[1:] == [
        "script: 140 samples dropped: nothing was read",
        "script: its lines ended",
        "script: 149 skipped in all",
    ]


def test_lines_that_are_no_samples_are_counted_and_end_nothing(model: Model) -> None:
    clock = VirtualClock()
    source, _, said = opened(clock, rubbish=b"rubbish")
    answers = answered(model, clock, source, 900)
    source.close()
    reports = [one for one in said if "rubbish" in one or "more" in one]
    assert 2 <= len(reports) <= 2 + 900 // 150
    assert {one.state for one in answers[150:]} == {"nothing"}


def test_the_end_of_the_lines_is_a_sentence_and_the_end() -> None:
    source, _, said = opened(VirtualClock(), ends=30)
    count = sum(1 for _ in iter(source.read, None))
    assert source.read() is None
    assert count == 30
    source.close()
    assert said[-1] == "script: its lines ended"


def test_a_calibration_turns_a_field_into_a_force() -> None:
    clock = VirtualClock()
    feed = ScriptedFeed(clock)
    reader = SampleReader(unit="uT", to_force=lambda field: 2.0 * field)
    source = LineSource(feed, reader, clock, print, RATE_HZ)
    assert source.unit == "N"
    assert read(source).values[0] == 2.0 * json.loads(feed.line(0))["X1"]


@pytest.mark.parametrize(
    ("script", "error", "says"),
    [
        ({"ends": 0}, DeviceNotFound, "start the sender"),
        ({"late_ns": lambda k: 10**12}, DeviceNotFound, "in 10 s"),
        ({"line": lambda k: b"a"}, DeviceNotFound, "not understood"),
        ({"line": lambda k: b"a"}, DeviceNotFound, "correct the lines"),
        ({"line": text_of, "ends": 1}, RateError, "rate_hz=150"),
    ],
)
def test_a_source_without_samples_says_so(
    script: Any, error: type[Exception], says: str
) -> None:
    with pytest.raises(error, match=says):
        opened(VirtualClock(), None, **script)


def slow(k: int) -> int:
    """A line that came at a seventh of a second."""
    return k * (SECOND_NS // 7 - PERIOD_NS)


TICK_NS = 10_000_000


@pytest.mark.parametrize(
    ("script", "says"),
    [
        # a clock of the sender that ticks every 10 ms, one that stands, broken and cut lines
        (
            {"line": lambda k: text_of(k, t_ns=k * PERIOD_NS // TICK_NS * TICK_NS)},
            r"35 of 106 lines were skipped: 35 stamped like the line before",
        ),
        (
            {"line": lambda k: text_of(k, t_ns=5)},
            r"\d+ of \d+ lines were skipped: \d+ stamped like the line before",
        ),
        (
            {"line": lambda k: text_of(k) if k % 7 else text_of(k)[:99]},
            r"\d+ of \d+ lines were skipped: \d+ not understood",
        ),
        (
            {"late_ns": slow, "bytes_per_s": 4000.0},
            r"the port is full: at 40000 baud it carries 7\.\d* lines of 5\d\d bytes",
        ),
    ],
)
def test_a_rate_that_losses_made_is_not_called_a_model_for_another_rate(
    model: Model, script: Any, says: str
) -> None:
    clock = VirtualClock()
    source, _, said = opened(clock, None, **script)
    assert re.search(says, said[-1])
    with pytest.raises(RateError, match=says) as error:
        answered(model, clock, source, 10)
    assert "correct the sender" in str(error.value)
    assert "another rate" not in str(error.value)


def test_a_rate_without_losses_is_another_one(model: Model) -> None:
    clock = VirtualClock()
    # one broken line in forty
    source, _, _ = opened(
        clock,
        None,
        late_ns=lambda k: k * PERIOD_NS,
        line=lambda k: text_of(k) if k % 40 else b"broken",
    )
    with pytest.raises(RateError, match="a model made for another rate"):
        answered(model, clock, source, 10)


def test_bytes_without_an_end_of_line_are_no_silent_sender() -> None:
    clock = VirtualClock()
    feed = ScriptedFeed(clock, late_ns=lambda k: 10**12)
    feed._lines.split(b"\xf8\x80" * 50)
    with pytest.raises(DeviceNotFound, match=r"100 bytes came, and no end.*baud="):
        LineSource(feed, SampleReader(), clock, print)


# -- bytes


@given(
    st.lists(st.binary(max_size=40), max_size=20),
    st.lists(st.integers(1, 9), max_size=60),
)
def test_lines_are_the_same_however_they_are_cut(
    lines: list[bytes], cuts: list[int]
) -> None:
    lines = [one.replace(b"\n", b"") for one in lines]
    data = b"".join(one + b"\n" for one in lines)
    splitter = LineSplitter()
    found: list[bytes] = []
    for size in [*cuts, len(data)]:
        found += splitter.split(data[:size])
        data = data[size:]
    assert found == lines


def test_a_line_without_an_end_takes_no_memory_and_is_counted_once() -> None:
    splitter = LineSplitter()
    found = [line for _ in range(1000) for line in splitter.split(b"x" * 1000)]
    assert [len(line) for line in found] == [LONGEST_LINE + 1]
    assert splitter.split(b"tail\nwhole\n") == [b"whole"]


@pytest.fixture
def stack() -> Iterator[ExitStack]:
    with ExitStack() as stack:
        yield stack


class Sender:
    """Sends a line a period, when the source asks for the time."""

    def __init__(self, send: Callable[[bytes], object]) -> None:
        self.send, self.k, self._sent_ns = send, 0, 0
        self._clock = RunClock()

    def now_ns(self) -> int:
        now_ns = self._clock.now_ns()
        if now_ns - self._sent_ns >= PERIOD_NS:
            self._sent_ns = now_ns
            self.send(text_of(self.k) + b"\n")
            self.k += 1
        return now_ns

    def wait_until(self, t_ns: int) -> None:
        self._clock.wait_until(t_ns)


def test_a_unix_socket_is_of_its_owner_alone_and_gone_at_the_end(
    stack: ExitStack, tmp_path: Path
) -> None:
    path = tmp_path / "hand"
    out = stack.enter_context(socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM))
    out.setblocking(False)

    def send(text: bytes) -> None:
        with suppress(FileNotFoundError, BlockingIOError):
            out.sendto(text, str(path))

    source = open_live(f"unix://{path}?rate_hz=150", clock=Sender(send), report=print)
    stack.callback(source.close)
    assert read(source).valid.all()
    assert path.stat().st_mode & 0o777 == 0o600
    source.close()
    assert not path.exists()


# -- words of the URL


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("udp://127.0.0.1:9000", "no such source"),
        ("unix://relative", "three slashes"),
        ("serial://dev/ttyACM0", "three slashes"),
        ("serial:///dev/ttyACM0?baud=fast", "baud = 'fast'"),
        ("stdin://?speed=1", "speed is not known"),
        ("stdin://?unit=kg", "allowed: N or uT or count"),
        ("stdin://?stamps=sender", "stamps is not known"),
        ("stdin://?rate_hz=nan", "rate_hz"),
        ("stdin://?rate_hz=0", "from 1 to 10000"),
        ("stdin://?map=a.toml&unit=N", "into the map"),
    ],
)
def test_a_url_that_cannot_be_is_a_usage_error(url: str, says: str) -> None:
    with pytest.raises(UsageError) as error:
        open_live(url, clock=VirtualClock(), report=print)
    assert says in str(error.value)


def test_a_file_on_standard_input_is_a_recording(
    stack: ExitStack, tmp_path: Path
) -> None:
    path = tmp_path / "trial_1.csv"
    path.write_text("Time,X1,Y1,Z1\n0,1,2,3\n")
    stdin = os.dup(0)
    stack.callback(os.dup2, stdin, 0)
    with path.open() as file:
        os.dup2(file.fileno(), 0)
    with pytest.raises(UsageError, match="replay://FILE"):
        open_live("-", clock=VirtualClock(), report=print)


# -- exact times


def test_a_missing_sample_is_noticed_after_two_periods_and_each_later_one_after_one() -> (
    None
):
    clock = VirtualClock()
    gone = range(10, 20)
    source, feed, _ = opened(clock, late_ns=lambda k: None if k in gone else 0)
    for _ in range(10):
        read(source)
    at_ns = [feed.arrives_ns(9)]
    while (reading := read(source)).why[:1] == (LOST,):
        assert not reading.valid.any()
        assert (reading.t_ns, reading.why) == (at_ns[0], (LOST,) * 6)
        at_ns.append(clock.now_ns())
    steps = np.round(np.diff(at_ns) / PERIOD_NS, 3).tolist()
    assert steps == [2.0, *[1.0] * 9]


@pytest.mark.parametrize(("waiting", "why"), [(2, ""), (3, SKIPPED)])
def test_two_samples_may_wait_and_of_three_the_newest_alone_is_read(
    waiting: int, why: str
) -> None:
    clock = VirtualClock()
    source, feed, _ = opened(clock)
    read(source)
    clock.wait_until(feed.arrives_ns(waiting))
    first, second = read(source), read(source)
    assert first.why == (why,) * 6
    assert second.values[0] == json.loads(feed.line(waiting))["X1"]


@pytest.mark.parametrize(("pause_ns", "why"), [(20_000_000, SKIPPED), (20_000_001, "")])
def test_after_a_pause_of_more_than_three_periods_what_waits_has_no_known_time(
    pause_ns: int, why: str
) -> None:
    clock = VirtualClock()
    source, feed, _ = opened(clock)
    read(source)
    clock.spend(pause_ns)
    reading = read(source)
    assert reading.why == (why,) * 6
    assert why or reading.t_ns == feed.arrives_ns(4)


def test_a_burst_at_the_beginning_does_not_count_for_the_rate() -> None:
    clock = VirtualClock()
    source, _, _ = opened(clock, None, late_ns=lambda k: max(0, (20 - k) * PERIOD_NS))
    assert source.rate_hz == pytest.approx(150.0, rel=1e-6)


# -- what waited before, and tables


def table(k: int) -> bytes:
    """A table of one sensor: a header, then rows."""
    return b"X1,Y1,Z1" if k == 0 else f"{k},{2 * k},{3 * k}".encode()


def test_a_header_that_waited_before_the_program_names_the_rows_that_come_later() -> (
    None
):
    clock = VirtualClock(20 * PERIOD_NS)
    source, feed, said = opened(clock, line=table)
    assert feed.next == 21
    assert said[0].endswith("; 19 samples before that are dropped")
    assert read(source).values.tolist() == [20.0, 40.0, 60.0]


# -- where bytes come from


def test_the_end_of_standard_input_is_the_end_and_closes_nothing(
    stack: ExitStack,
) -> None:
    reads, writes = os.pipe()
    stack.callback(os.close, reads)
    feed = StreamFeed("stdin", reads)
    assert feed.pull(0.0) == []
    os.write(writes, b"one\ntwo\nhalf")
    assert feed.pull(1.0) == [b"one", b"two"]
    os.close(writes)
    assert (feed.pull(0.0), feed.ended) == ([], True)
    feed.close()
    assert os.fstat(reads)


@pytest.fixture
def board() -> Iterator[TtyReceiver]:
    """The other end of a port."""
    with closing(TtyReceiver()) as one:
        yield one


def test_a_serial_port_that_goes_is_reported_and_opened_again_when_it_comes_back(
    stack: ExitStack, tmp_path: Path, board: TtyReceiver
) -> None:
    first, name, said = TtyReceiver(), tmp_path / "ttyHAND", list[str]()
    name.symlink_to(first.path)
    boards = [first]

    def send(text: bytes) -> None:
        # a carriage return and a Ctrl-C come as they are
        if boards:
            boards[0].write(text.replace(b"\n", b"\r"))

    url = f"serial://{name}?rate_hz=150&baud=230400"
    source = open_live(url, clock=Sender(send), report=said.append)
    stack.callback(source.close)
    assert read(source).valid.all()
    boards.clear()
    first.close()
    name.unlink()
    while len(said) < 3:
        read(source)
    assert read(source).why == (LOST,) * 6
    name.symlink_to(board.path)
    boards.append(board)
    while not read(source).valid.all():
        pass
    lost, back = said[2:]
    assert lost.startswith(f"serial://{name}: lost (")
    assert lost.endswith("likely cause: it was unplugged")
    assert back == f"serial://{name}: back"


def test_another_reader_that_takes_what_came_is_no_end(
    board: TtyReceiver, monkeypatch: pytest.MonkeyPatch
) -> None:
    said: list[str] = []
    feed = SerialFeed(board.path, 115200, said.append)
    waits = select.select

    def looks(*what: Any) -> Any:
        """What is there is gone before the feed reads it."""
        ready = waits(*what)
        if ready[0]:
            os.read(board.other, 4096)
        return ready

    with monkeypatch.context() as patched:
        patched.setattr(select, "select", looks)
        board.write(b"one")
        assert feed.pull(10.0) == []
    board.write(b"two")
    assert (feed.pull(10.0), said) == ([b"two"], [])
    feed.close()


def test_a_port_is_for_one_program_which_reads_it_once_and_may_write_to_it(
    board: TtyReceiver,
) -> None:
    feed = SerialFeed(board.path, 115200, print)
    writer = open_port(board.path)
    with pytest.raises(UsageError, match="read already"):
        SerialFeed(board.path, 115200, print)
    os.write(writer.fd, b"hold\n")
    assert board.raw() == b"hold"
    for port in (writer, feed):
        with pytest.raises(BlockingIOError):
            fcntl.flock(board.other, fcntl.LOCK_EX | fcntl.LOCK_NB)
        close_port(port) if port is writer else feed.close()
    fcntl.flock(board.other, fcntl.LOCK_EX | fcntl.LOCK_NB)
    with pytest.raises(AccessDenied, match="another program has opened it"):
        open_port(board.path)


def test_datagrams_are_cut_into_lines_that_hold_something(tmp_path: Path) -> None:
    feed = DatagramFeed(f"{tmp_path}/hand")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as ours:
        ours.connect(f"{tmp_path}/hand")
        for datagram in (b"one\n\ntwo\n", b"\n", b"three"):
            ours.send(datagram)
    assert feed.pull(0.5) == [b"one", b"two", b"three"]
    assert (feed.pull(-0.5), feed.ended) == ([], False)
    feed.close()
    assert not (tmp_path / "hand").exists()
