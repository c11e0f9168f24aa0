"""Attacks on the port of the wearer's commands: forged, replayed and flooding datagrams."""

from __future__ import annotations

import os
import random
import socket
import stat
import tempfile
from collections.abc import Callable, Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import pytest
from hazard_marks import BROKEN_LINE, FLOODED_PORT, FORGED_LINE
from numbered_lines import NumberedSender, numbered_sender

from holdfast.core.errors import UsageError
from holdfast.core.line_key import LinkKey, read_key
from holdfast.core.line_port import MOST_A_CALL, line_port, printable
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.edge_runtime.commands import Command, command_port

PERIOD_NS = 6_666_667
FORGED = (
    b'{"opening": true}',
    b'{"opening": true, "override": true}',
    b'{"session": 666, "sequence": 9007199254740991, "opening": true}',
    b'{"session": 4127, "sequence": 9007199254740991, "opening": true}',
    b'{"session": 4127, "sequence": 0, "opening": true}',
    b'{"session": 4127, "sequence": Infinity, "opening": true}',
    b"[" * 2000,
    b"null",
    b"\x1b[2J",
)
"""What a blind attacker sends, with a session that happens to be right among it."""


@dataclass
class Port:
    """A command port under attack."""

    address: Any
    clock: VirtualClock
    log: list[str]
    now: Callable[[], Command]

    def ask(self) -> Command:
        """The command at a sample, a period after the one before."""
        self.clock.spend(PERIOD_NS)
        return self.now()


@contextmanager
def listening(kind: str, folder: Path, key: LinkKey | None) -> Iterator[Port]:
    """A command port over UDP or a Unix socket."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        host, number = probe.getsockname()
    address: Any = (host, number) if kind == "udp" else str(folder / "commands")
    url = f"udp://{host}:{number}" if kind == "udp" else f"unix://{address}"
    if key is not None:
        url += f"?key={key.path}"
    clock, log = VirtualClock(10**9), list[str]()
    with command_port(url, log.append, clock.now_ns) as ask:
        yield Port(address, clock, log, ask)


@pytest.fixture
def key(tmp_path: Path) -> LinkKey:
    """A key in a file."""
    path = tmp_path / "link.key"
    path.write_text("k" * 40, encoding="ascii")
    path.chmod(0o600)
    return read_key(path, "commands")


def flood(attacker: socket.socket, port: Port, lines: int, seed: int) -> int:
    """Forged datagrams until the queue is full; how many were sent."""
    draw = random.Random(seed)
    sent = 0
    for _ in range(lines):
        with suppress(BlockingIOError):
            attacker.sendto(draw.choice(FORGED), port.address)
            sent += 1
    return sent


@contextmanager
def attacker_of(kind: str) -> Iterator[socket.socket]:
    family = socket.AF_UNIX if kind == "unix" else socket.AF_INET
    with socket.socket(family, socket.SOCK_DGRAM) as attacker:
        attacker.setblocking(False)
        yield attacker


@FORGED_LINE.mark
@FLOODED_PORT.mark
@pytest.mark.parametrize("keyed", [False, True])
def test_a_flood_opens_no_hand_loses_no_override_and_fills_no_log(
    keyed, tmp_path, key, record_property
):
    used = key if keyed else None
    with (
        listening("udp", tmp_path, used) as port,
        attacker_of("udp") as attacker,
        numbered_sender(port.address, key=used) as wearer,
    ):
        wearer.send({"opening": False})
        assert port.ask() == Command(link="live")
        forged, opened, overrides = 0, 0, 0
        for k in range(200):
            forged += flood(attacker, port, 300, seed=k)
            wearer.send({"override": True} if k % 10 == 0 else {})
            command = port.ask()
            opened += command.opening
            overrides += command.override
        record_property("forged datagrams", forged)
        assert (opened, overrides) == (0, 20)
        shown = [line for line in port.log if "skipped" in line or " more " in line]
        # 1.3 s: the first, and one a second after it
        assert len(shown) <= 3
        assert sum(map(len, port.log)) < 20_000


@FORGED_LINE.mark
def test_with_a_key_a_flood_that_comes_first_and_old_sessions_open_no_hand(
    tmp_path, key
):
    with (
        listening("udp", tmp_path, key) as port,
        attacker_of("udp") as attacker,
        numbered_sender(port.address, 5, key) as earlier,
        numbered_sender(port.address, 6, key) as wearer,
    ):
        recorded = [earlier.line({"opening": True}) for _ in range(20)]
        attacker.sendto(recorded[0], port.address)
        assert port.ask().opening
        attacker.sendto(wearer.line({"opening": False}), port.address)
        port.clock.spend(301_000_000)
        wearer.send({"opening": False})
        assert not port.ask().opening
        port.clock.spend(301_000_000)
        for line in recorded:
            attacker.sendto(line, port.address)
        flood(attacker, port, 100, seed=1)
        assert [port.ask() for _ in range(5)] == [Command(link="expired")] * 5


@FLOODED_PORT.mark
def test_a_sender_that_comes_back_from_another_port_is_followed(tmp_path):
    with ExitStack() as stack:
        port = stack.enter_context(listening("udp", tmp_path, None))
        for k in range(5):
            sender = stack.enter_context(numbered_sender(port.address))
            sender._numbers = iter(range(10 * k, 10 * k + 10))
            sender.send({"override": True})
            assert port.ask().override
            sender.send({"override": True})
            assert port.ask().override


@FLOODED_PORT.mark
def test_a_sample_reads_a_bounded_number_of_datagrams(tmp_path):
    with (
        listening("unix", tmp_path, None) as port,
        socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as sender,
    ):
        sender.setblocking(False)
        sent = 0
        with suppress(BlockingIOError):
            while sent < 5 * MOST_A_CALL:
                sender.sendto(b'{"opening": true}', port.address)
                sent += 1
        assert port.ask().opening
        assert len(port.log) == 1


# -- a Unix socket


def test_over_a_unix_socket_a_command_needs_no_session_and_may_have_one(tmp_path):
    with (
        listening("unix", tmp_path, None) as port,
        numbered_sender(port.address) as wearer,
    ):
        wearer.send(b'{"opening": true}')
        assert port.ask() == Command(opening=True, link="live")
        wearer.send({"opening": False})
        assert port.ask() == Command(link="live")


def test_a_command_behind_a_line_that_is_skipped_is_obeyed_at_the_same_sample(tmp_path):
    with (
        listening("unix", tmp_path, None) as port,
        numbered_sender(port.address) as wearer,
    ):
        wearer.send(b"no command")
        wearer.send(b'{"opening": true}')
        assert port.ask().opening


@FORGED_LINE.mark
@pytest.mark.parametrize("umask", [0o000, 0o022, 0o077])
def test_a_socket_file_is_for_its_owner_only_whatever_the_umask(tmp_path, umask):
    before = os.umask(umask)
    try:
        with listening("unix", tmp_path, None) as port:
            assert stat.S_IMODE(os.stat(str(port.address)).st_mode) == 0o600
    finally:
        os.umask(before)
    assert not (tmp_path / "commands").exists()


@FORGED_LINE.mark
@pytest.mark.skipif(os.getuid() != 0, reason="only root can act as another user")
def test_another_user_of_the_board_cannot_send_to_a_socket_file():
    with (
        tempfile.TemporaryDirectory() as folder,
        listening("unix", Path(folder), None) as port,
        attacker_of("unix") as attacker,
    ):
        Path(folder).chmod(0o755)
        os.seteuid(65534)
        try:
            with pytest.raises(PermissionError):
                attacker.sendto(b'{"opening": true}', port.address)
        finally:
            os.seteuid(0)
        assert port.ask() == Command()
        attacker.sendto(b'{"opening": true}', port.address)
        assert port.ask().opening


def test_what_a_program_left_behind_is_replaced_and_nothing_else(tmp_path):
    path = tmp_path / "commands"
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as dead:
        dead.bind(str(path))
    with (
        listening("unix", tmp_path, None) as port,
        numbered_sender(port.address) as wearer,
    ):
        wearer.send({"override": True})
        assert port.ask().override
        with (
            pytest.raises(UsageError, match="in use"),
            listening("unix", tmp_path, None),
        ):
            pass
        wearer.send({"override": True})
        assert port.ask().override
    path.write_text("kept", encoding="utf-8")
    with pytest.raises(UsageError, match="in use"), listening("unix", tmp_path, None):
        pass
    assert path.read_text("utf-8") == "kept"


def test_two_programs_never_share_a_port(tmp_path):
    with listening("udp", tmp_path, None) as port:
        host, number = port.address
        for _ in range(2):
            with (
                pytest.raises(UsageError, match="in use"),
                command_port(f"{host}:{number}", print, port.clock.now_ns),
            ):
                pass
            sender = NumberedSender(port.address)
            with sender.socket:
                sender.send({"override": True})
                assert port.ask().override
                port.clock.spend(301_000_000)


@pytest.mark.parametrize(
    "url",
    [
        "9001",
        "udp://127.0.0.1",
        "udp://127.0.0.1:99999",
        "udp://:9001",
        "udp://127.0.0.1:9001/a",
        "udp://127.0.0.1:9001?speed=1",
        "tcp://127.0.0.1:9001",
        "unix://relative",
        "unix:///",
        "unix:///no/such/folder/commands",
        "unix:///" + "a" * 200,
        "unix:///a%00b",
        "udp://[::1:9001",
        "serial:///dev/ttyS0",
    ],
)
def test_an_address_that_cannot_be_is_a_usage_error(url):
    with (
        pytest.raises(UsageError),
        command_port(url, print, VirtualClock().now_ns),
    ):
        pass


@BROKEN_LINE.mark
def test_a_skipped_line_is_shown_without_control_characters(tmp_path):
    messages: list[str] = []
    clock = VirtualClock()
    with (
        line_port("udp://127.0.0.1:0", "intent", messages.append, clock.now_ns) as port,
        numbered_sender(port.address()) as sender,
    ):
        sender.send(b"\x1b[2J\xff\x00" + b"x" * 1000)
        assert port.came(lambda fields: fields) == []
    (line,) = messages
    assert line.isprintable()
    assert line.startswith("intent: ?[2J")
    assert len(line) < 200


def test_ten_changes_of_a_second_are_logged_one_by_one_and_the_others_counted():
    clock, log = VirtualClock(10**9), []
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as probe:
        probe.bind(("127.0.0.1", 0))
        address = probe.getsockname()
    with (
        command_port(f"127.0.0.1:{address[1]}", log.append, clock.now_ns) as ask,
        numbered_sender(address) as user,
    ):
        for k in range(13):
            user.send({"opening": k % 2 == 0})
            assert ask() == Command(opening=k % 2 == 0, link="live")
        assert len(log) == 10
        # no change
        user.send({"opening": True})
        ask()
    assert log[10:] == ["command: 3 more changes"]


def test_a_datagram_is_shown_by_its_first_80_printable_characters():
    assert printable(b"a" * 79 + b"bc") == "a" * 79 + "b"
    assert printable("\u00e4\x1b\n".encode() * 100) == ("\u00e4??" * 27)[:80]
    assert printable(b"\xff") == "\ufffd"


def test_of_many_lines_at_one_sample_an_override_counts_and_ten_changes_are_shown(
    tmp_path: Path,
) -> None:
    with (
        listening("udp", tmp_path, None) as port,
        numbered_sender(port.address) as wearer,
    ):
        for keys in ({"override": True}, {"override": True}, {"opening": True}):
            wearer.send(keys)
        assert port.ask() == Command(opening=True, override=True, link="live")
        assert port.ask() == Command(opening=True, link="live")
        for k in range(12):
            wearer.send({"opening": k % 2 > 0})
        assert port.ask() == Command(opening=True, link="live")
        shown = [line for line in port.log if "opening" in line or "override" in line]
        assert len(shown) == 10
