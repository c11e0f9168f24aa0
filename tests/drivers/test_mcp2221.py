"""The MCP2221A: an engine that hangs, is confused or is left in a transfer, its lengths and
speeds."""

from __future__ import annotations

import pytest
from bridge_bench import (
    ABSENT,
    FIRST,
    ID,
    IDENTITY,
    WHO,
    A,
)

from holdfast.core.errors import BusStuck, TransferFailed, UsageError
from holdfast.drivers.bus import Transfer
from holdfast.drivers.mcp2221 import Mcp2221, Status


def test_a_cancel_of_an_engine_that_was_never_used_hangs_it(make):
    bench = make("mcp2221")
    bench.engine().write(0x03, bytes([0x10, 0, 0x10]))
    with pytest.raises(TransferFailed, match="0x62"):
        bench.bus.scan([FIRST])
    bench.bus._port.reset()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_the_driver_never_cancels_an_engine_that_was_never_used(make):
    bench = make("mcp2221")
    bench.bus.clear()
    bench.bus.close()
    bench.bus = bench.open()
    bench.bus.scan([])
    bench.bus.clear()
    assert not bench.engine().hangs
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_a_confused_engine_makes_its_next_transfer_bogus(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST, WHO])
    engine = bench.engine()
    engine.tick_sda()
    engine.write(0x03, bytes([0x91, 3, 0, ABSENT << 1 | 1]))
    engine.write(0x03, bytes([0x40]))
    assert engine.read(0x83, 64)[1:7] == bytes([0, 0x55, 3, 0xFF, 0xFF, 0xFF])


def test_the_driver_cancels_a_confused_engine_first(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST, WHO])
    bench.engine().tick_sda()
    assert bench.bus.scan([WHO])[0].data == IDENTITY


def test_an_engine_that_is_confused_in_the_middle_of_a_scan_is_cancelled(make):
    bench = make("mcp2221")
    engine = bench.engine()
    write = engine._write
    engine._write = lambda kind, *values: (
        write(kind, *values),
        engine.tick_sda() if kind == 0x90 else None,
    )
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_the_mcp2221_reports_that_fewer_bytes_came_than_were_requested(make):
    bench = make("mcp2221")
    engine = bench.engine()
    read = engine._read
    engine._read = lambda address, length: read(address, length - 1)
    with pytest.raises(TransferFailed, match="2 of 3 bytes"):
        bench.bus.scan([FIRST, WHO])
    engine._read = read
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_an_engine_that_was_never_used_is_not_cancelled_while_sda_is_low(make):
    bench = make("mcp2221")
    bench.hand.wire.hold_low()
    for ask in (bench.bus.clear, lambda: bench.bus.scan([FIRST]), bench.bus.clear):
        with pytest.raises(BusStuck, match="SDA"):
            ask()
    bench.bus.close()
    with pytest.raises(BusStuck, match="SDA"):
        bench.open()
    while bench.hand.wire.held_low:
        bench.hand.wire.clock()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_a_transfer_after_a_nack_that_was_not_cancelled_is_bogus(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    engine = bench.engine()
    engine.write(0x03, bytes([0x90, 1, 0, ABSENT << 1]))
    assert engine.state == 0x25
    engine.write(0x03, bytes([0x90, 1, 0, 0xE0, 2]))
    assert engine.state == 0x00
    assert bench.hand.mux.control == 1  # the write to the mux never was on the wire


def test_an_engine_that_another_program_left_in_a_nack_is_cancelled_when_it_is_opened(
    make,
):
    bench = make("mcp2221")
    bench.engine().write(0x03, bytes([0x90, 1, 0, ABSENT << 1]))
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize(
    "command", [[0x94, 1, 0, A << 1, ID], [0x91, 3, 0, A << 1 | 1]]
)
def test_an_engine_left_in_the_middle_of_a_transfer_is_cancelled(make, command):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    bench.engine().write(0x03, bytes(command))
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize("length", [1, 60])
def test_the_mcp2221_carries_up_to_60_bytes(make, length):
    bench = make("mcp2221")
    assert len(bench.bus.scan([FIRST, Transfer(A, b"\0", length)])[1].data) == length
    assert bench.bus.scan([Transfer(A, bytes(length))])[0].acked


def test_the_mcp2221_says_that_a_transfer_is_too_long(make):
    bench = make("mcp2221")
    for transfer in (Transfer(A, bytes(61)), Transfer(A, b"\0", 61)):
        with pytest.raises(TransferFailed, match=r"61 bytes.*at most 60"):
            bench.bus.scan([FIRST, transfer])
    assert bench.hand.mux.control == 0  # and nothing of such a scan is carried out


@pytest.mark.parametrize("bus_hz", [47_000, 100_000, 400_000])
def test_the_mcp2221_runs_at_the_speed_of_the_url(make, bus_hz):
    bench = make("mcp2221")
    bench.bus.close()
    bench.bus = Mcp2221(bench.backend, bus_hz=bus_hz)
    assert bench.engine().bus_hz == pytest.approx(bus_hz, rel=0.01)
    assert len(bench.bus.scan([FIRST, Transfer(A, b"\0", 60)])[1].data) == 60
    assert bench.bus.scan([FIRST, Transfer(A, bytes(60)), WHO])[2].data == IDENTITY


@pytest.mark.parametrize(
    ("bus_hz", "divider"), [(47_000, "fc"), (65_000, "b6"), (400_000, "1b")]
)
def test_the_engine_is_told_its_divider_to_the_nearest(make, bus_hz, divider):
    bench = make("mcp2221")
    bench.bus.close()
    sent = []
    write = bench.engine().write
    bench.engine().write = lambda at, data: (
        sent.append(data.hex(" ")) or write(at, data)
    )
    bench.bus = Mcp2221(bench.backend, bus_hz=bus_hz)
    assert sent[-1].startswith(f"10 00 00 20 {divider} 00")


@pytest.mark.parametrize("bus_hz", [46_999, 400_001])
def test_the_mcp2221_refuses_other_speeds(make, bus_hz):
    with pytest.raises(UsageError):
        Mcp2221(make("mcp2221").backend, bus_hz=bus_hz)


def test_an_engine_that_hangs_ends_in_an_error_and_not_in_a_loop(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    bench.engine().hangs = True
    bench.backend.traffic.transfers = 0
    with pytest.raises(TransferFailed, match="0x62"):
        bench.bus.scan([Transfer(ABSENT, b"\0")])
    assert bench.backend.traffic.transfers < 100


@pytest.mark.parametrize(
    ("status", "ready"),
    [
        (Status(0, False, True, True, True), True),
        (Status(0, False, False, True, True), True),
        (Status(1, False, True, True, True), False),
        (Status(0, True, True, True, True), False),
        (Status(0, False, True, False, True), False),
        (Status(0, False, True, True, False), False),
    ],
)
def test_an_engine_is_ready_where_it_is_idle_and_both_lines_are_high(status, ready):
    assert status.ready == ready


def test_a_hanging_engine_is_asked_and_cancelled_so_often_and_then_named(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    sent = []
    write = bench.bus._port.write
    bench.bus._port.write = lambda *given: sent.append(given[1][:3]) or write(*given)
    bench.engine().hangs = True
    with pytest.raises(TransferFailed, match=r"hangs in state 0x62.*unplug it"):
        bench.bus.scan([Transfer(ABSENT, b"\0")])
    cancels = [one for one in sent if one[2]]
    assert (len(cancels), set(cancels)) == (3, {b"\x10\0\x10"})


def test_an_engine_that_works_is_asked_twenty_times(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    asked = []
    bus, ask = bench.bus, bench.bus._ask

    def working(command):
        asked.append(command[0])
        reply = bytearray(ask(command))
        reply[8 if command[0] == 0x10 else 2] = 0x50
        if command[0] == 0x40:
            reply[1] = 0x41
        return bytes(reply)

    bus._ask = working
    with pytest.raises(TransferFailed, match="hangs in state 0x50"):
        bus.scan([FIRST])
    # once to see that it is ready, then after each of three cancels
    assert len(asked) == 20 + 3 * (1 + 20)
    bus._ask = ask


def test_a_line_that_is_low_is_named(make):
    bench = make("mcp2221")
    for scl, sda, says in (
        (False, True, "SCL is"),
        (True, False, "SDA is"),
        (False, False, "SCL"),
    ):
        error = bench.bus._not_ready(Status(0, False, True, scl, sda))
        assert isinstance(error, BusStuck)
        assert says in str(error)


def asked(bench, *answers):
    """The engine's reports are answered by these, then by itself; what it was asked."""
    commands = []
    waiting, ask = list(answers), bench.bus._ask

    def answered(command):
        commands.append(command.hex(" "))
        return waiting.pop(0) if waiting else ask(command)

    bench.bus._ask = answered
    return commands


def report(**bytes_at):
    """A report of 64 zeros but for the bytes at these places (`b8` for byte 8)."""
    reply = bytearray(64)
    for name, byte in bytes_at.items():
        reply[int(name[1:])] = byte
    return bytes(reply)


def test_each_transfer_is_these_reports(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    commands = asked(bench)
    bench.bus.scan([Transfer(A, bytes([ID, 2])), WHO, Transfer(A, b"", 60)])
    assert commands == [
        "10",
        "90 02 00 6a 0d 02",
        "10",
        "94 01 00 6a 0d",
        "10",
        "93 03 00 6b",
        "40",
        "91 3c 00 6b",
        "40",
    ]


@pytest.mark.parametrize(
    ("places", "status"),
    [
        ({}, Status(0, False, False, False, False)),
        ({"b8": 0x61, "b21": 1}, Status(0x61, False, True, False, False)),
        ({"b18": 8, "b22": 1}, Status(0, True, False, True, False)),
        ({"b18": 7, "b23": 255}, Status(0, False, False, False, True)),
        ({"b18": 9, "b21": 255}, Status(0, False, True, False, False)),
        ({"b8": 0x45, "b18": 8}, Status(0x45, False, False, False, False)),
        ({"b8": 0x46, "b18": 8}, Status(0x46, True, False, False, False)),
        ({"b8": 0x44, "b18": 8}, Status(0x44, True, False, False, False)),
    ],
)
def test_a_status_has_its_state_its_confusion_its_use_and_its_lines(
    make, places, status
):
    bench = make("mcp2221")
    asked(bench, report(**places))
    assert bench.bus._status() == status


READY = {"b22": 1, "b23": 1}


def test_data_are_taken_once_the_engine_has_them_and_says_that_they_are_right(make):
    bench = make("mcp2221")
    answers = [
        report(**READY),
        report(),
        # not yet, not right, then there
        report(b2=0x54),
        report(b2=0x60),
        report(b1=0x41, b2=0x55, b3=2, b4=9, b5=9),
        report(b2=0x55, b3=2, b4=7, b5=8, b6=9),
    ]
    commands = asked(bench, *answers)
    assert bench.bus.scan([Transfer(A, b"", 2)])[0].data == b"\x07\x08"
    assert commands == ["10", "91 02 00 6b", "40", "40", "40", "40"]


@pytest.mark.parametrize(
    ("answers", "state"),
    [
        # the engine takes no transfer, ends a write in another state, or a read
        ([report(b1=1, b2=0x33)], "0x33"),
        ([report(), report(b8=0x62, **READY)], "0x62"),
    ],
)
def test_a_transfer_that_the_engine_gives_up_is_cancelled_and_named(
    make, answers, state
):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    commands = asked(bench, report(**READY), *answers)
    with pytest.raises(TransferFailed, match=f"the transfer ended in state {state}"):
        bench.bus.scan([FIRST])
    assert "10 00 10" in commands
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


def test_a_late_reply_is_read_away_before_the_next_scan(make):
    bench = make("mcp2221")
    bench.bus.scan([FIRST])
    port = bench.bus._port
    for wrong, says in (
        (bytes(64), "reply 0x00 to 0x10"),
        (b"\x10" * 65, "of 65 bytes"),
    ):
        read, cleared = port.read, []
        port.read = lambda *given, wrong=wrong: wrong
        with pytest.raises(TransferFailed, match=says):
            bench.bus.scan([FIRST])
        port.read = read
        clear = port.clear_halt
        port.clear_halt = lambda one, cleared=cleared: cleared.append(one)
        assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY
        assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY
        assert cleared == [0x03, 0x83]
        port.clear_halt = clear
