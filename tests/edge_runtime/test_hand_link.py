"""Grip commands on their way to a hand: whatever fails, the last command is `hold`."""

from __future__ import annotations

import signal
import socket
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np
import pytest
from grip_bench import TtyReceiver, UnixReceiver, command, opened, send, sender, until
from hazard_marks import NO_GRIP_COMMAND, OLD_COMMAND, RUN_DIES, WIRE_FAILS

from holdfast.core.errors import DeviceNotFound, UsageError
from holdfast.edge_runtime.supervisor import to_line


@pytest.fixture(params=[UnixReceiver, TtyReceiver])
def receiver(request) -> Iterator[UnixReceiver | TtyReceiver]:
    one = request.param()
    yield one
    one.close()


@pytest.fixture
def tty() -> Iterator[TtyReceiver]:
    one = TtyReceiver()
    yield one
    one.close()


@NO_GRIP_COMMAND.mark
def test_every_command_arrives_and_the_last_one_holds(receiver):
    with opened(receiver.url) as link:
        send(link, 1, 2, 3)
        assert [receiver.next()["sequence"] for _ in range(3)] == [1, 2, 3]
    last = receiver.next()
    assert (last["mode"], last["target_n"], last["reason"]) == ("hold", None, "stopped")
    assert last["sequence"] == 4
    assert last["expires_ms"] == 300


@RUN_DIES.mark
def test_a_run_that_is_killed_leaves_lines_that_expire(receiver):
    with sender(receiver.url) as process:
        process.send_signal(signal.SIGKILL)
        process.wait(300)
    lines = [receiver.next() for _ in range(3)]
    assert [line["sequence"] for line in lines] == [40, 41, 42]
    assert {line["expires_ms"] for line in lines} == {300}


@RUN_DIES.mark
def test_a_run_that_ends_by_an_error_says_so_in_its_last_hold(receiver):
    with sender(receiver.url, "raise") as process:
        process.communicate(timeout=300)
        assert process.returncode == 1
        assert receiver.until("failed")["mode"] == "hold"


@WIRE_FAILS.mark
def test_a_stalled_reader_never_delays_a_command_and_gets_hold_when_it_reads(receiver):
    messages: list[str] = []
    with opened(receiver.url, messages.append) as link:
        # a port of this test says at once that it is a pseudo-terminal
        messages.clear()
        k, took_s = 0, []
        while not messages:
            k += 1
            began_s = time.monotonic()
            link(to_line(command(k)), k)
            took_s.append(time.monotonic() - began_s)
            time.sleep(0.001)
        # One that waited for the reader would take 300 ms, after which the link counts as failed.
        # The median, because a busy machine stops any program for a while.
        assert np.median(took_s) < 0.1
        assert "the hand holds its grip" in messages[0]
        assert link.dropped > 20
        while receiver.next()["reason"] != "link was lost":
            pass
        until(lambda: link.works)
        send(link, k + 1)
        assert receiver.next()["sequence"] == k + 1
    assert "arrive again" in messages[1]
    assert "did not leave" in messages[-1]


@WIRE_FAILS.mark
def test_a_stalled_reader_keeps_no_run_from_ending(receiver):
    messages: list[str] = []
    with opened(receiver.url, messages.append) as link:
        messages.clear()
        while not messages:
            link(to_line(command(1)), 1)
            time.sleep(0.001)
        began_s = time.monotonic()
    assert time.monotonic() - began_s < 1.0


@WIRE_FAILS.mark
def test_an_unplugged_port_comes_back_under_its_name_and_begins_with_hold(
    tmp_path: Path, tty
):
    messages: list[str] = []
    name = tmp_path / "ttyHAND"
    first = TtyReceiver()
    name.symlink_to(first.path)
    with opened(f"serial://{name}", messages.append) as link:
        messages.clear()
        send(link, 1)
        assert first.next()["sequence"] == 1
        first.close()
        name.unlink()
        k = 2
        while not messages:
            send(link, k)
            k += 1
        name.symlink_to(tty.path)
        until(lambda: link.works)
        send(link, k)
        assert [tty.next()["reason"] for _ in range(2)] == [
            "link was lost",
            "risky slip",
        ]
    assert tty.next()["reason"] == "stopped"


@WIRE_FAILS.mark
def test_a_line_that_was_cut_off_does_not_spoil_the_last_one(tty):
    with opened(tty.url) as link:
        send(link, 1)
        assert tty.next()["sequence"] == 1
        with open(tty.path, "wb", buffering=0) as other:
            other.write(b'{"sequence":2,"t_n')
    assert tty.next()["reason"] == "stopped"


@WIRE_FAILS.mark
def test_a_slow_port_gets_the_newest_command_and_queues_none(tty, monkeypatch):
    room = [0]
    is_full = property(lambda port: room[0])
    monkeypatch.setattr("serial.Serial.out_waiting", is_full)
    with opened(tty.url) as link:
        send(link, 1)
        room[0] = 500
        for k in (2, 3, 4):
            link(to_line(command(k)), k)
        room[0] = 50
        assert [tty.next()["sequence"] for _ in range(2)] == [1, 4]
        assert link.dropped == 2


@OLD_COMMAND.mark
def test_a_port_that_does_not_say_what_waits_in_it_is_told(tty):
    messages: list[str] = []
    with opened(tty.url, messages.append):
        pass
    assert [one for one in messages if "lines can arrive late" in one]


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:9000",
        "tcp://127.0.0.1:9000",
        "udp://127.0.0.1:9000",
        "unix://relative",
        "unix:///run/a?key=b",
        "serial://",
        "serial://ttyUSB0",
        "serial:///dev/null?speed=9600",
        "serial:///dev/null?baud=fast",
        "udp://[::1:9000",
    ],
)
def test_an_address_that_cannot_be_is_a_usage_error(url):
    with pytest.raises(UsageError), opened(url):
        pass


def stale_socket(path: Path) -> None:
    """As a program that was killed leaves it."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as one:
        one.bind(str(path))


def stream_socket(path: Path) -> None:
    """Of a program that expects connections; its file is enough."""
    with socket.socket(socket.AF_UNIX, socket.SOCK_STREAM) as one:
        one.bind(str(path))
        one.listen()


IN_THE_WAY: dict[str, tuple[Callable[[Path], object], str]] = {
    "nothing": (lambda path: None, "No such file or directory"),
    "a socket without a program": (stale_socket, "Connection refused"),
    "a loop of links": (lambda path: path.symlink_to(path), "symbolic links"),
    "a socket of streams": (stream_socket, "refused"),
}


@WIRE_FAILS.mark
@pytest.mark.parametrize("what", IN_THE_WAY)
def test_what_stands_in_the_way_of_a_command_is_told_and_that_none_left(what, tmp_path):
    make, says = IN_THE_WAY[what]
    path, messages = tmp_path / "hand" / "grip", list[str]()
    path.parent.mkdir()
    make(path)
    with opened(f"unix://{path}", messages.append) as link:
        send(link, 1)
        until(lambda: messages)
        assert says in messages[0]
        assert link.carried_none


IMPOSSIBLE: dict[str, tuple[Callable[[Path], object], str]] = {
    "a file": (lambda path: path.write_text(""), "is no socket"),
    "a folder": (lambda path: path.mkdir(), "is no socket"),
    "x" * 120: (lambda path: None, "longer than 107 bytes"),
}


@pytest.mark.parametrize("name", IMPOSSIBLE)
def test_a_path_at_which_no_receiver_can_come_is_refused(name, tmp_path):
    make, says = IMPOSSIBLE[name]
    make(tmp_path / name)
    with pytest.raises(UsageError, match=says), opened(f"unix://{tmp_path / name}"):
        pass


@pytest.mark.parametrize("path", ["/dev/null", "/dev/no-such-port", "/etc/hostname"])
def test_what_is_not_a_serial_port_is_a_device_error(path):
    with pytest.raises(DeviceNotFound, match="serial"), opened(f"serial://{path}"):
        pass


@WIRE_FAILS.mark
def test_a_receiver_that_is_not_there_yet_or_starts_again_is_found(tmp_path):
    messages, path = list[str](), str(tmp_path / "grip")
    with opened(f"unix://{path}", messages.append) as link:
        send(link, 1)
        until(lambda: messages)
        assert "No such file or directory" in messages[0]
        first = UnixReceiver(path)
        assert first.until("link was lost")["sequence"] == 1
        until(lambda: link.works)
        first.close()
        send(link, 2)
        second = UnixReceiver(path)
        assert second.next()["mode"] == "hold"
        until(lambda: link.works)
        send(link, 3)
        assert second.next()["sequence"] == 3
        until(lambda: len(messages) == 4)
    assert second.until("stopped")["sequence"] == 4
    second.close()
