"""Grip commands on their way to a hand: whatever fails, the last command is `hold`."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from grip_bench import (
    Hands,
    TtyReceiver,
    UdpReceiver,
    UnixReceiver,
    command,
    opened,
    send,
    sender,
    wait_for_the_end_of,
)
from hazard_marks import FORGED_LINE, NO_GRIP_COMMAND, RUN_DIES, WIRE_FAILS

from holdfast.core.errors import DataNotFound, DeviceNotFound, UsageError
from holdfast.core.line_key import LinkKey, read_key
from holdfast.core.line_session import LineReceiver, LineSender
from holdfast.edge_runtime.supervisor import to_line
from holdfast.live.guardian import Guardian
from holdfast.live.links import BITS_A_CODE, BITS_A_COMMAND, open_link

A_WHILE_NS = 3_000_000_000


@pytest.fixture(params=[UdpReceiver, UnixReceiver, TtyReceiver])
def receiver(request) -> Iterator[UdpReceiver | TtyReceiver]:
    one = request.param()
    yield one
    one.close()


@pytest.fixture
def tty() -> Iterator[TtyReceiver]:
    one = TtyReceiver()
    yield one
    one.close()


def send_slowly(sink, clock: Hands, numbers: range) -> None:
    """So long after one another that a lost link is tried again each time."""
    for k in numbers:
        clock.ns += A_WHILE_NS
        send(sink, k)


@pytest.fixture
def udp() -> Iterator[UdpReceiver]:
    one = UdpReceiver()
    yield one
    one.close()


@NO_GRIP_COMMAND.mark
def test_every_command_arrives_and_the_last_one_holds(receiver):
    with opened(receiver.url, Hands(), []) as sink:
        assert send(sink, 1, 2, 3) == [True] * 3
        assert [receiver.next()["sequence"] for _ in range(3)] == [1, 2, 3]
    last = receiver.next()
    assert (last["mode"], last["target_n"], last["reason"]) == ("hold", None, "stopped")
    assert last["sequence"] == 4
    assert last["expires_ms"] == 300


def test_the_guardian_is_silent_after_a_goodbye(udp):
    with sender(udp.url) as (process, guardian):
        process.communicate(timeout=300)
        assert process.returncode == 0
        wait_for_the_end_of(guardian)
    lines = udp.waiting()
    assert [line["reason"] for line in lines] == ["risky slip"] * 3 + ["stopped"]


@RUN_DIES.mark
def test_a_killed_run_leaves_a_hold_that_says_that_the_process_died(receiver):
    with sender(receiver.url) as (process, _):
        process.send_signal(signal.SIGKILL)
        last = receiver.until("process died")
    assert (last["mode"], last["target_n"], last["sequence"]) == ("hold", None, 43)
    assert last["t_ns"] > 0


@RUN_DIES.mark
def test_the_guardian_outlives_the_signals_that_end_a_whole_service(receiver):
    with sender(receiver.url) as (process, guardian):
        for number in (signal.SIGTERM, signal.SIGINT, signal.SIGHUP, signal.SIGABRT):
            os.kill(guardian, number)
        process.kill()
        assert receiver.until("process died")["mode"] == "hold"


@RUN_DIES.mark
def test_a_guardian_that_ends_is_reported_once(receiver):
    messages: list[str] = []
    with opened(receiver.url, Hands(), messages) as sink:
        os.kill(sink._guardian.pid, signal.SIGKILL)
        wait_for_the_end_of(sink._guardian.pid)
        assert send(sink, 1, 2) == [True, True]
        assert len(messages) == 1
        assert "guardian" in messages[0]


@RUN_DIES.mark
def test_a_run_that_ends_by_an_error_says_so_in_its_last_hold(receiver):
    with sender(receiver.url, "raise") as (process, _):
        process.communicate(timeout=300)
        assert process.returncode == 1
        assert receiver.until("failed")["mode"] == "hold"


@WIRE_FAILS.mark
def test_a_port_without_a_receiver_is_reported_once_and_its_return_begins_with_hold(
    udp,
):
    clock, messages = Hands(), []
    with opened(udp.url, clock, messages) as sink:
        send(sink, 1)
        udp.close()
        send_slowly(sink, clock, range(2, 40))
        assert len(messages) == 1
        assert "no line arrives" in messages[0]
        again = UdpReceiver(udp.port)
        send_slowly(sink, clock, range(40, 50))
        lines = again.waiting()
    assert [line["reason"] for line in lines[:3]] == ["link was lost"] * 3
    assert {line["mode"] for line in lines[:3]} == {"hold"}
    assert lines[-1]["sequence"] == 49
    assert "arrive again" in messages[1]
    assert "did not leave" in messages[2]
    assert len(messages) == 3
    again.close()


def test_retries_become_rarer_up_to_two_seconds(udp):
    clock = Hands()
    with opened(udp.url, clock, []) as sink:
        udp.close()
        tries = []
        write = sink._link.write
        sink._link.write = lambda line: tries.append(clock.ns) or write(line)
        for k in range(3000):
            clock.ns += 6_666_667
            send(sink, k)
    assert 10 < len(tries) < 60


@WIRE_FAILS.mark
def test_a_stalled_reader_never_delays_a_command_and_is_reported(tty):
    clock = Hands()
    messages: list[str] = []
    with opened(tty.url, clock, messages) as sink:
        for k in range(2000):
            clock.ns += 6_666_667
            send(sink, k)
        assert "stalled" in messages[0]
        assert len(messages) < 10  # the system may find room for a few more lines
        assert sink.dropped > 1000
        os.set_blocking(tty.handle, False)
        with suppress(BlockingIOError):
            while os.read(tty.handle, 65536):
                pass
        send_slowly(sink, clock, range(2000, 2020))
        tty.until("link was lost")
        while tty.next()["sequence"] != 2019:
            pass
    assert "arrive again" in messages[-2]


@WIRE_FAILS.mark
def test_an_unplugged_port_comes_back_under_its_name_and_begins_with_hold(
    tmp_path: Path, tty
):
    clock = Hands()
    messages: list[str] = []
    name = tmp_path / "ttyHAND"
    first = TtyReceiver()
    name.symlink_to(first.path)
    with opened(f"serial://{name}", clock, messages) as sink:
        assert send(sink, 1) == [True]
        assert first.next()["sequence"] == 1
        first.close()
        name.unlink()
        send_slowly(sink, clock, range(2, 6))
        assert len(messages) == 1
        name.symlink_to(tty.path)
        k = 6
        while len(messages) < 2:
            send_slowly(sink, clock, range(k, k + 1))
            opening = getattr(sink._link, "_opening", None)
            if opening is not None:
                opening.join()
            k += 1
        assert send(sink, k) == [True]
        reasons = [tty.next()["reason"] for _ in range(4)]
        assert reasons == ["link was lost"] * 3 + ["risky slip"]
    assert tty.next()["reason"] == "stopped"


@RUN_DIES.mark
def test_the_guardian_holds_the_descriptor_that_it_was_given_last(udp):
    first = UdpReceiver()
    guardian = Guardian('{"sequence":%(sequence)d,"t_ns":%(t_ns)d}')
    for receiver in (first, udp):
        link = open_link(receiver.url, "--grip")
        guardian.hold(link.handle)
        link.close()
    guardian.note(8)
    guardian.end(written=False)
    assert udp.next()["sequence"] == 9
    assert first.waiting() == []
    first.close()


def test_a_guardian_that_was_let_go_of_its_port_writes_nothing(udp):
    guardian = Guardian("{}")
    link = open_link(udp.url, "--grip")
    guardian.hold(link.handle)
    guardian.release()
    guardian.end(written=False)
    wait_for_the_end_of(guardian.pid)
    assert udp.waiting() == []
    link.close()


@WIRE_FAILS.mark
def test_a_line_that_was_cut_off_does_not_spoil_the_one_after_it(tty):
    clock = Hands()
    with opened(tty.url, clock, []) as sink:
        send(sink, 1)
        os.write(sink._link.handle, b'{"sequence":2,"t_n')
    assert tty.next()["sequence"] == 1
    assert tty.next()["reason"] == "stopped"


@WIRE_FAILS.mark
def test_a_slow_port_leaves_out_commands_and_queues_none(tty, monkeypatch):
    import holdfast.live.links as links

    waiting = iter([0, 500, 200, 50])
    monkeypatch.setattr(links, "unsent_bytes", lambda port: next(waiting))
    with opened(tty.url, Hands(), []) as sink:
        assert send(sink, 1, 2, 3, 4) == [True, False, False, True]
        assert sink.dropped == 2
    assert [tty.next()["sequence"] for _ in range(2)] == [1, 4]


@pytest.mark.parametrize(
    "url",
    [
        "127.0.0.1:9000",
        "tcp://127.0.0.1:9000",
        "udp://127.0.0.1",
        "udp://127.0.0.1:99999",
        "udp://:9000",
        "udp://no.such.host.invalid:9000",
        "serial://",
        "serial://ttyUSB0",
        "serial:///dev/null?speed=9600",
        "serial:///dev/null?baud=fast",
        "serial:///dev/null?baud=115201",
        "udp://[::1:9000",
    ],
)
def test_an_address_that_cannot_be_is_a_usage_error(url):
    with pytest.raises(UsageError):
        open_link(url, "--grip")


@pytest.mark.parametrize("path", ["/dev/null", "/dev/no-such-port", "/etc/hostname"])
def test_what_is_not_a_serial_port_is_a_device_error(path):
    with pytest.raises(DeviceNotFound, match="serial"):
        open_link(f"serial://{path}", "--grip")


@WIRE_FAILS.mark
def test_a_receiver_that_is_not_there_yet_or_starts_again_is_found(tmp_path):
    clock, messages, path = Hands(), list[str](), str(tmp_path / "grip")
    with opened(f"unix://{path}", clock, messages) as sink:
        assert send(sink, 1) == [False]
        assert "there is no receiver" in messages[0]
        first = UnixReceiver(path)
        send_slowly(sink, clock, range(2, 10))
        assert [line["reason"] for line in first.waiting()][:3] == ["link was lost"] * 3
        first.close()
        assert send(sink, 10) == [False]
        second = UnixReceiver(path)
        send_slowly(sink, clock, range(11, 20))
        lines = second.waiting()
        assert [line["mode"] for line in lines][:4] == ["hold"] * 3 + ["tighten"]
        assert len(messages) == 4
    assert second.until("stopped")["sequence"] == 20
    second.close()


def test_a_wire_without_a_line_to_pass_on_is_tried_with_rising_numbers(tmp_path):
    clock, path = Hands(), str(tmp_path / "cues")
    with opened(f"unix://{path}", clock, []) as sink:
        assert send(sink, 1) == [False]
        receiver = UnixReceiver(path)
        for k in range(5, 9):
            clock.ns += A_WHILE_NS
            sink.look(k)
        assert [line["sequence"] for line in receiver.waiting()] == [5, 6, 7]
    assert receiver.next()["sequence"] == 8
    receiver.close()


# -- sessions and keys


def test_every_line_of_a_run_has_its_session_and_a_rising_number(receiver):
    sessions = []
    for _ in range(2):
        with opened(receiver.url, Hands(), []) as sink:
            send(sink, 3, 5, 9)
        lines = [receiver.next() for _ in range(4)]
        assert [line["sequence"] for line in lines] == [3, 5, 9, 10]
        (session,) = {line["session"] for line in lines}
        sessions.append(session)
        assert lines[0]["target_n"] == 9.4
        assert "mac" not in lines[0]
    assert sessions[0] != sessions[1]


@FORGED_LINE.mark
def test_with_a_key_every_line_is_sealed_also_the_guardian_s(receiver, tmp_path):
    path = tmp_path / "link.key"
    path.write_text("k" * 32, encoding="ascii")
    path.chmod(0o600)
    key, clock = read_key(path, "grip"), Hands()
    ear = LineReceiver(clock.now_ns, 150, key=key)
    with sender(f"{receiver.url}?key={path}") as (process, guardian):
        command_line = Path(f"/proc/{guardian}/cmdline").read_bytes()
        process.kill()
        reasons = [
            ear.take(receiver.raw(), lambda fields: fields["reason"]) for _ in range(4)
        ]
    assert reasons == ["risky slip"] * 3 + ["process died"]
    assert b"k" * 32 not in command_line


def test_a_key_that_is_no_key_is_an_error_before_the_run(tmp_path):
    with pytest.raises(DataNotFound, match="no such key"):
        open_link(f"udp://127.0.0.1:9000?key={tmp_path / 'none'}", "--grip")


def test_a_serial_port_s_rate_counts_the_whole_line(tmp_path):
    line = LineSender(2**53 - 1).line(to_line(command(10**6)._replace(mu_hat=0.6123)))
    assert 10 * len(line) < BITS_A_COMMAND < 14 * len(line)
    key = LinkKey(b"k" * 32, "grip")
    assert 10 * (len(key.sealed(line)) - len(line)) == BITS_A_CODE
