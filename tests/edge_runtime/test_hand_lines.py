"""Lines to a hand: which are obeyed, what is skipped, and the port of the wearer's commands."""

from __future__ import annotations

import os
import socket
import stat
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

import pytest
from hazard_marks import BROKEN_LINE, OTHER_SENDER
from hypothesis import given
from hypothesis import strategies as st
from numbered_lines import numbered_sender

from holdfast.core.errors import UsageError
from holdfast.core.hand_lines import (
    MOST_A_CALL,
    SILENCE_NS,
    RisingRule,
    Skipped,
    fields_of,
    line_port,
    printable,
    sequence_of,
)
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.edge_runtime.commands import Command, command_port

PERIOD_NS = 6_666_667


# -- the rule


def test_rising_sequences_are_obeyed_and_after_300_ms_any_may_begin() -> None:
    rule = RisingRule()
    assert rule.obeys(0, 5)
    assert [rule.obeys(1, one) for one in (5, 4, 0)] == [False] * 3
    assert rule.obeys(SILENCE_NS, 6)
    assert not rule.obeys(2 * SILENCE_NS, 0)
    assert rule.lives(2 * SILENCE_NS)
    assert not rule.lives(2 * SILENCE_NS + 1)
    assert rule.obeys(2 * SILENCE_NS + 1, 0)


@given(
    st.lists(
        st.tuples(st.integers(0, 400_000_000), st.none() | st.integers(0, 9)),
        max_size=60,
    )
)
def test_a_line_that_is_obeyed_is_above_the_last_one_or_comes_after_a_silence(
    lines: list[tuple[int, int | None]],
) -> None:
    rule, now_ns, obeyed_ns, newest = RisingRule(), 0, None, None
    for later_ns, sequence in lines:
        now_ns += later_ns
        silent = obeyed_ns is None or now_ns - obeyed_ns > SILENCE_NS
        above = sequence is None or newest is None or sequence > newest
        assert rule.obeys(now_ns, sequence) == (silent or above)
        if silent or above:
            obeyed_ns, newest = now_ns, sequence


@pytest.mark.parametrize(
    "line",
    [
        b"",
        b"1",
        b"[]",
        b"null",
        b"[" * 2000,
        b"{",
        b'{"a": NaN}',
        b"\xff",
        b"{}{}",
        b"{" + b" " * (16 << 10) + b"}",
    ],
)
def test_what_is_not_one_json_object_has_no_fields(line: bytes) -> None:
    with pytest.raises(ValueError, match=r"."):
        fields_of(line)


@pytest.mark.parametrize("value", [-1, 1.0, True, "1", [1]])
def test_a_sequence_is_a_whole_number_from_0_on(value: object) -> None:
    with pytest.raises(ValueError, match="sequence"):
        sequence_of(value)
    assert sequence_of(None) is None
    assert sequence_of(0) == 0


def test_what_is_skipped_is_said_once_a_second_and_counted() -> None:
    clock, said = VirtualClock(), list[str]()
    skipped = Skipped("commands", said.append, clock.now_ns)
    for _ in range(150):
        skipped.count("not rising", "a line")
        clock.spend(10_000_000)
    skipped.close()
    assert said == [
        "commands: a line",
        "commands: a line (99 more before)",
        "commands: 49 more are skipped",
    ]
    assert skipped.total == {"not rising": 150}


# -- the port of the wearer's commands


@dataclass
class Port:
    """A command port."""

    path: Path
    clock: VirtualClock
    log: list[str]
    now: Callable[[], Command]

    def ask(self) -> Command:
        """The command at a sample, a period after the one before."""
        self.clock.spend(PERIOD_NS)
        return self.now()


@contextmanager
def listening(folder: Path) -> Iterator[Port]:
    path = folder / "commands"
    clock, log = VirtualClock(10**9), list[str]()
    with command_port(f"unix://{path}", log.append, clock.now_ns) as ask:
        yield Port(path, clock, log, ask)


def test_an_opening_lasts_until_it_is_taken_back_and_an_override_for_one_sample(
    tmp_path: Path,
) -> None:
    with listening(tmp_path) as port, numbered_sender(port.path) as wearer:
        assert port.ask() == Command()
        wearer.send({"opening": True})
        wearer.send({"override": True})
        wearer.send({})
        assert port.ask() == Command(opening=True, override=True, link="live")
        assert port.ask() == Command(opening=True, link="live")
        wearer.send({"opening": False})
        assert port.ask() == Command(link="live")
        assert [line for line in port.log if "opening" in line]


def test_a_command_of_a_sender_that_is_silent_expires_after_300_ms(
    tmp_path: Path,
) -> None:
    with listening(tmp_path) as port, numbered_sender(port.path) as wearer:
        wearer.send({"opening": True})
        assert port.ask().opening
        port.clock.spend(SILENCE_NS - PERIOD_NS)
        assert port.ask().opening
        assert port.ask() == Command(link="expired")
        assert port.log[-1].endswith("its last command has expired")


def test_a_line_without_a_sequence_is_obeyed_as_it_comes(tmp_path: Path) -> None:
    with listening(tmp_path) as port, numbered_sender(port.path) as wearer:
        for _ in range(2):
            wearer.send(b'{"override": true}')
            assert port.ask().override


@OTHER_SENDER.mark
def test_an_old_line_that_comes_late_moves_nothing(tmp_path: Path) -> None:
    with listening(tmp_path) as port, numbered_sender(port.path) as wearer:
        wearer.send({"sequence": 7, "opening": False})
        assert not port.ask().opening
        for late in (7, 6, 0):
            wearer.send({"sequence": late, "opening": True})
        assert not port.ask().opening
        assert "not rising" in port.log[-1]


@BROKEN_LINE.mark
def test_a_command_behind_a_line_that_is_skipped_is_obeyed_at_the_same_sample(
    tmp_path: Path,
) -> None:
    with listening(tmp_path) as port, numbered_sender(port.path) as wearer:
        for rubbish in (b"no command", b'{"opening": 1}', b'{"close": true}', b"[]"):
            wearer.send(rubbish)
        wearer.send({"opening": True})
        assert port.ask().opening


@BROKEN_LINE.mark
def test_a_skipped_line_is_shown_without_control_characters(tmp_path: Path) -> None:
    said: list[str] = []
    url = f"unix://{tmp_path}/intent"
    with (
        line_port(url, "intent", said.append, VirtualClock().now_ns) as port,
        numbered_sender(tmp_path / "intent") as sender,
    ):
        sender.send(b"\x1b[2J\xff\x00" + b"x" * 1000)
        assert port.came(lambda fields: fields) == []
    (line,) = said
    assert line.isprintable()
    assert line.startswith("intent: ?[2J")
    assert len(line) < 200
    assert printable(b"a" * 79 + b"bc") == "a" * 79 + "b"


def test_a_sample_reads_a_bounded_number_of_datagrams(tmp_path: Path) -> None:
    with listening(tmp_path) as port, numbered_sender(port.path) as sender:
        sender.socket.setblocking(False)
        with suppress(BlockingIOError):
            for _ in range(5 * MOST_A_CALL):
                sender.send({"opening": True})
        assert port.ask().opening
        assert len(port.log) == 1


@OTHER_SENDER.mark
@pytest.mark.parametrize("umask", [0o000, 0o077])
def test_a_socket_file_is_for_its_owner_only_whatever_the_umask(
    tmp_path: Path, umask: int
) -> None:
    before = os.umask(umask)
    try:
        with listening(tmp_path) as port:
            assert stat.S_IMODE(port.path.stat().st_mode) == 0o600
    finally:
        os.umask(before)
    assert not (tmp_path / "commands").exists()


def test_what_a_program_left_behind_is_replaced_and_nothing_else(
    tmp_path: Path,
) -> None:
    path = tmp_path / "commands"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as dead:
        dead.bind(str(path))
    with listening(tmp_path) as port, numbered_sender(path) as wearer:
        with pytest.raises(UsageError, match="in use"), listening(tmp_path):
            pass
        wearer.send({"override": True})
        assert port.ask().override
    path.write_text("kept", encoding="utf-8")
    with pytest.raises(UsageError, match="in use"), listening(tmp_path):
        pass
    assert path.read_text("utf-8") == "kept"


@pytest.mark.parametrize(
    ("url", "says"),
    [
        ("9001", "not an address"),
        ("127.0.0.1:9001", "not an address"),
        ("udp://127.0.0.1:9001", "nothing that moves a hand crosses a network"),
        ("unix:///run/a?key=b", "key is not known"),
        ("unix://relative", "not an address"),
        ("unix:///no/such/folder/commands", "cannot listen"),
        ("unix:///" + "a" * 200, "cannot listen"),
        ("udp://[::1:9001", "not an address"),
        ("serial:///dev/ttyS0", "not an address"),
    ],
)
def test_an_address_that_cannot_be_is_a_usage_error(url: str, says: str) -> None:
    with (
        pytest.raises(UsageError, match=says),
        command_port(url, print, VirtualClock().now_ns),
    ):
        pass
