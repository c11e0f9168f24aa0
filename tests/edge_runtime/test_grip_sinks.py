"""Grip commands on their way to a hand: whatever fails, the last command is `hold`."""

from __future__ import annotations

import itertools
import os
import signal
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import pytest
from grip_bench import (
    Hands,
    TtyReceiver,
    UnixReceiver,
    command,
    opened,
    send,
    sender,
)
from hazard_marks import NO_GRIP_COMMAND, RUN_DIES, WIRE_FAILS

from holdfast.core.errors import DeviceNotFound, UsageError
from holdfast.edge_runtime.supervisor import to_line
from holdfast.live.links import BITS_A_COMMAND, open_link

A_WHILE_NS = 3_000_000_000


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


def send_slowly(sink, clock: Hands, numbers: range) -> None:
    """So long after one another that a lost link is tried again each time."""
    for k in numbers:
        clock.ns += A_WHILE_NS
        send(sink, k)


@NO_GRIP_COMMAND.mark
def test_every_command_arrives_and_the_last_one_holds(receiver):
    with opened(receiver.url, Hands(), []) as sink:
        assert send(sink, 1, 2, 3) == [True] * 3
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


def test_retries_become_rarer_up_to_two_seconds(tmp_path):
    clock, tries, reader = Hands(), [], UnixReceiver(str(tmp_path / "grip"))
    with opened(reader.url, clock, []) as sink:
        write = sink._link.write
        sink._link.write = lambda line: tries.append(clock.ns) or write(line)
        for k in range(3000):
            clock.ns += 6_666_667
            send(sink, k)
    # the reader takes nothing: from the failure on ever longer pauses
    pauses_s = [1e-9 * (b - a) for a, b in itertools.pairwise(tries)]
    assert len(tries) < 400
    assert max(pauses_s) == pytest.approx(2.0, abs=0.01)
    reader.close()


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
        "udp://127.0.0.1:9000",
        "unix://relative",
        "unix:///run/a?key=b",
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


def test_a_serial_port_s_rate_counts_the_whole_line(tmp_path):
    line = to_line(command(10**6)._replace(mu_hat=0.6123))
    assert 10 * len(line) < BITS_A_COMMAND < 14 * len(line)
