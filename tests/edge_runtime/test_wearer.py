"""The wearer's command as a stream: what is understood, when it is unknown, its file."""

from __future__ import annotations

import math
import os
import socket
import stat
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from grip_bench import TtyReceiver, until
from hazard_marks import BROKEN_LINE, OTHER_SENDER, SILENT_SENDER
from hypothesis import given, settings
from hypothesis import strategies as st
from numbered_lines import numbered_sender

from holdfast.core.contract import Command
from holdfast.core.errors import DeviceLost, NotANumber, UsageError
from holdfast.core.hand_lines import SILENCE_NS
from holdfast.drivers.lsl import LslInlet, LslIntent, StreamFacts
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.edge_runtime.wearer import (
    INTENT_HEADER,
    Intent,
    IntentMonitor,
    intent_row,
    read_intent,
)
from holdfast.live.running import RunClock
from holdfast.live.wearer import wearer_monitor

PERIOD_NS = 6_666_667


class Hand:
    """A clock by hand, a stream of scripted items, and messages."""

    def __init__(self) -> None:
        self.ns, self.next = 10**9, list[Intent]()
        self.messages: list[str] = []
        self.monitor = IntentMonitor(self.came, lambda: self.ns, self.messages.append)

    def came(self) -> list[Intent]:
        came, self.next = self.next, []
        return came

    def sample(self, *words: str, later_ns: int = PERIOD_NS) -> Command:
        """Some time passes, these words come; what is commanded then."""
        self.ns += later_ns
        self.next = [Intent(self.ns, word) for word in words]
        return self.monitor.command()


@pytest.fixture
def hand() -> Hand:
    one = Hand()
    assert one.sample() == Command(link="none")
    assert one.monitor.newest.wants == "unknown"
    return one


@pytest.mark.parametrize("word", ["open", "close", "stop"])
def test_a_word_lasts_for_three_tenths_of_a_second_of_silence_to_the_nanosecond(
    hand, word
):
    assert hand.sample(word) == Command(word == "open", link="live")
    assert hand.sample(later_ns=SILENCE_NS) == Command(word == "open", link="live")
    assert hand.sample(later_ns=1) == Command(link="expired")
    assert [one.wants for one in hand.monitor.fresh] == ["unknown"]
    assert hand.sample() == Command(link="expired")
    assert hand.monitor.fresh == []
    assert len(hand.messages) == 1
    assert hand.sample(word).link == "live"
    assert hand.messages[1:] == ["wearer: the stream is back"]


def test_what_waited_while_nothing_looked_is_dropped(hand):
    assert hand.sample("open", later_ns=SILENCE_NS).opening
    assert hand.sample("stop", later_ns=SILENCE_NS + 1) == Command(link="expired")
    # also before the first look, and more than one call of the stream gives
    waiting = [[Intent(0, "open")], [Intent(1, "open")], [], [Intent(10**9, "stop")]]
    first = IntentMonitor(lambda: waiting.pop(0), lambda: 10**9, print)
    assert first.command() == Command()
    assert first.command() == Command(link="live")


@settings(deadline=None, max_examples=50)
@given(st.lists(st.none() | st.sampled_from(["open", "close", "stop"]), max_size=300))
def test_the_wish_is_never_older_than_it_may_be_and_never_made_up(stream):
    hand = Hand()
    hand.sample()
    last, word = None, None
    for one in stream:
        hand.sample(*([one] if one else []))
        if one:
            last, word = hand.ns, one
        fresh = last is not None and hand.ns - last <= SILENCE_NS
        assert hand.monitor.newest.wants == (word if fresh else "unknown")
        assert (hand.monitor.link == "live") == fresh


def test_an_override_counts_for_the_sample_at_which_it_came(hand):
    assert hand.sample("override", "open") == Command(True, True, "live")
    assert hand.sample() == Command(True, False, "live")


# -- lines


@dataclass
class Listening:
    """A run that listens at a socket file."""

    path: Path
    clock: VirtualClock
    log: list[str]
    monitor: IntentMonitor

    def ask(self) -> Command:
        """The command at a sample, a period after the one before."""
        self.clock.spend(PERIOD_NS)
        return self.monitor.command()


@contextmanager
def listening(folder: Path) -> Iterator[Listening]:
    path, clock, log = folder / "wearer", VirtualClock(10**9), list[str]()
    with wearer_monitor(f"unix://{path}", clock, log.append) as monitor:
        one = Listening(path, clock, log, monitor)
        assert one.ask() == Command()
        yield one


@SILENT_SENDER.mark
def test_a_word_comes_as_an_object_or_bare_and_an_opening_lasts_until_it_expires(
    tmp_path: Path,
) -> None:
    with listening(tmp_path) as run, numbered_sender(run.path) as wearer:
        lines = [{"wants": "open"}, b"open", b"open\nstop\nopen\n"]
        # what else stands in a line is not asked for
        lines += [{"wants": "open", "emg": math.nan}, b' {"emg":-inf,"wants":"open"}\r']
        for line in lines:
            wearer.send(line)
            assert run.ask() == Command(opening=True, link="live")
        wearer.send({"wants": "stop"})
        assert run.ask() == Command(link="live")
        wearer.send({"wants": "open"})
        assert run.ask().opening
        run.clock.spend(SILENCE_NS - PERIOD_NS)
        assert run.ask().opening
        assert run.ask() == Command(link="expired")
        assert "silent" in run.log[-1]


@OTHER_SENDER.mark
def test_an_old_line_that_comes_late_moves_nothing(tmp_path: Path) -> None:
    with listening(tmp_path) as run, numbered_sender(run.path) as wearer:
        wearer.send({"sequence": 7, "wants": "stop"})
        assert not run.ask().opening
        for late in (7, 6, 0):
            wearer.send({"sequence": late, "wants": "open"})
        assert not run.ask().opening
        assert "not rising" in run.log[-1]


@BROKEN_LINE.mark
@pytest.mark.parametrize(
    "rubbish",
    [
        b"\xff\x1b[2J",
        b"[0.5, 0.5]",
        {},
        {"wants": "closed"},
        {"wants": ""},
        {"wants": None},
        {"wants": ["open"]},
        {"envelope": [0.5]},
        {"opening": True},
    ],
)
def test_what_is_not_understood_is_skipped_and_a_word_behind_it_counts(
    tmp_path: Path, rubbish: Any
) -> None:
    with listening(tmp_path) as run, numbered_sender(run.path) as wearer:
        for _ in range(3):
            wearer.send(rubbish)
        wearer.send({"wants": "open"})
        assert run.ask().opening
        (line,) = run.log
        assert "is skipped: not understood" in line
        assert line.isprintable()
        run.clock.spend(SILENCE_NS - PERIOD_NS)
        wearer.send(rubbish)
        assert run.ask().opening
        wearer.send(rubbish)
        assert run.ask() == Command(link="expired")


@OTHER_SENDER.mark
@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_a_socket_file_is_for_its_owner_only_whatever_the_umask(
    tmp_path: Path, umask: int
) -> None:
    before = os.umask(umask)
    try:
        with listening(tmp_path) as run:
            assert stat.S_IMODE(run.path.stat().st_mode) == 0o600
    finally:
        os.umask(before)
    assert not (tmp_path / "wearer").exists()


def test_what_a_program_left_behind_is_replaced_and_nothing_else(
    tmp_path: Path,
) -> None:
    path = tmp_path / "wearer"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as dead:
        dead.bind(str(path))
    with (
        listening(tmp_path),
        pytest.raises(UsageError, match="in use"),
        listening(tmp_path),
    ):
        pass
    path.write_text("kept", encoding="utf-8")
    with pytest.raises(UsageError, match="in use"), listening(tmp_path):
        pass
    assert path.read_text("utf-8") == "kept"


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("9001", "is not an address"),
        ("sim://apple", "is not an address"),
        ("udp://127.0.0.1:9001", "nothing that moves a hand crosses a network"),
        ("unix:///run/a?key=b", "key is not known"),
        ("unix://relative", "three slashes"),
        ("unix:///no/such/folder/wearer", "cannot listen"),
        ("unix:///" + "a" * 200, "cannot listen"),
        ("lsl://", "is no stream"),
    ],
)
def test_an_address_that_cannot_be_is_a_usage_error(url: str, says: str) -> None:
    with (
        pytest.raises(UsageError, match=says),
        wearer_monitor(url, VirtualClock(), print),
    ):
        pass


def test_a_recorded_stream_comes_again_in_its_time(tmp_path: Path) -> None:
    path, clock = tmp_path / "trial_1.intent.csv", VirtualClock(10**9)
    rows = [
        INTENT_HEADER,
        "0.0,6,close",
        "0.1,7,open",
        "0.2,8,unknown",
        "0.3,9,rest",
        "",
    ]
    path.write_text("\n".join(rows), encoding="utf-8")
    with wearer_monitor(f"replay://{path}", clock, print) as monitor:
        said = []
        for _ in range(100):
            monitor.look()
            said += [(item.t_ns, item.wants) for item in monitor.fresh]
            clock.spend(PERIOD_NS)
    assert said[0] == (1_000_000_000, "close")
    assert said[1:3] == [(1_100_000_000, "open"), (1_300_000_000, "stop")]
    assert [wants for _, wants in said[3:]] == ["unknown"]


def test_a_port_that_goes_is_unknown_until_it_comes_back(tmp_path):
    first, name, messages = TtyReceiver(), tmp_path / "ttyEMG", list[str]()
    name.symlink_to(first.path)
    with (
        closing(TtyReceiver()) as second,
        wearer_monitor(f"serial://{name}", RunClock(), messages.append) as monitor,
    ):
        monitor.look()
        first.write(b"open")
        until(lambda: monitor.command().opening)
        first.close()
        name.unlink()
        until(lambda: monitor.command().link == "expired")
        name.symlink_to(second.path)
        until(lambda: monitor.look() or messages[-1].endswith("back"))
        second.write(b"close")
        until(lambda: monitor.command().link == "live")
    assert [one.rpartition(": ")[2] for one in messages] == [
        "it was unplugged",
        "the stream is silent; what the wearer wants is unknown",
        "back",
        "the stream is back",
    ]


# -- the lab streaming layer


class ScriptedInlet(LslInlet):
    """Gives what it was given; its clock is 1000 s ahead of the run's."""

    def __init__(self, pairs: list[tuple[float, list[Any]]]) -> None:
        self.facts = StreamFacts("emg", True, 100.0, ("",), ("",) * 2)
        self.pairs = pairs

    def pull(self, timeout_s: float) -> list[Any]:
        assert timeout_s == 0.0
        if not self.pairs:
            raise DeviceLost("the stream ended")
        pairs, self.pairs = self.pairs, []
        return pairs

    def clock_s(self) -> float:
        return 1001.0

    def close(self) -> None:
        pass


def test_words_of_the_lab_streaming_layer_are_put_on_the_runs_clock():
    messages: list[str] = []
    pairs = [(1000.5, ["open"]), (1000.75, ["shut"]), (1009.0, ["stop"])]
    stream = LslIntent(ScriptedInlet(pairs), lambda: 10**9, messages.append)
    assert stream() == [Intent(500_000_000, "open"), Intent(10**9, "stop")]
    assert len(messages) == 1
    for _ in range(3):
        assert stream() == []
        assert messages[1:] == ["lsl://emg: the stream ended; it is unknown from here"]


# -- files


def test_a_file_reads_back_as_it_was_written_without_silences_and_a_torn_line(tmp_path):
    path = tmp_path / "trial_1.intent.csv"
    items = [Intent(1_600_000_000, "open"), Intent(1_900_000_001, "unknown")]
    rows = [intent_row(one, 10**9, 5) for one in items]
    path.write_text("\n".join([INTENT_HEADER, *rows, "1.0,7,op"]), encoding="utf-8")
    assert path.read_text("utf-8").startswith(
        f"{INTENT_HEADER}\n0.600000,1600000005,open\n"
    )
    assert read_intent(path) == [Intent(600_000_000, "open")]


def test_the_words_of_an_older_file_with_envelopes_are_read(tmp_path):
    path = tmp_path / "trial_1.intent.csv"
    lines = [
        f"{INTENT_HEADER},envelope 1 (0 to 1)",
        "0.5,7,open,",
        "0.6,8,,0.25",
        "0.7,9,rest,",
        "",
    ]
    path.write_text("\n".join(lines), encoding="utf-8")
    assert [one.wants for one in read_intent(path)] == ["open", "stop"]


@pytest.mark.parametrize("line", ["soon,5,open", "0.1,5,shut", "open"])
def test_a_damaged_file_is_an_error_with_its_place(tmp_path, line):
    path = tmp_path / "trial_1.intent.csv"
    path.write_text(f"{INTENT_HEADER}\n{line}\n", encoding="utf-8")
    with pytest.raises(NotANumber, match=r"line 2: .*") as raised:
        read_intent(path)
    assert "trial_1.intent.csv" in str(raised.value)
