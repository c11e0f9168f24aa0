"""Every bridge, by the same sentences: the FT232H and the board's own I2C."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from bridge_bench import (
    ABSENT,
    ALL,
    FIRST,
    ID,
    IDENTITY,
    SIX,
    THRESHOLD,
    WHO,
    A,
    B,
    Bench,
    every_bridge,
)

from holdfast.drivers.bus import NOT_ACKED, Reply, Transfer

# -- what every bridge does


@every_bridge
def test_a_register_that_was_written_reads_back(make, kind):
    write = Transfer(B, bytes([THRESHOLD, 0x5A, 0xA5]))
    read = Transfer(B, bytes([THRESHOLD]), 2)
    assert make(kind).bus.scan([FIRST, write, read])[2] == Reply(
        b"\x5a\xa5", acked=True
    )


@every_bridge
def test_a_read_goes_on_where_the_last_one_ended(make, kind):
    replies = make(kind).bus.scan(
        [FIRST, Transfer(A, bytes([ID]), 1), Transfer(A, read=2)]
    )
    assert [reply.data for reply in replies] == [b"", IDENTITY[:1], IDENTITY[1:]]


@every_bridge
def test_an_absent_chip_costs_only_itself(make, kind):
    absent = [
        Transfer(ABSENT, bytes([ID]), 3),
        Transfer(ABSENT, read=3),
        Transfer(ABSENT, b"\0\0"),
        Transfer(ABSENT),
    ]
    replies = make(kind).bus.scan(
        [FIRST, *(one for gone in absent for one in (gone, WHO))]
    )
    assert replies[1::2] == [NOT_ACKED] * 4
    assert replies[2::2] == [Reply(IDENTITY, acked=True)] * 4


# harbaum's: TODO, set status
@pytest.mark.parametrize("kind", ALL)
def test_a_byte_that_is_not_acknowledged_is_reported(make, kind):
    bench = make(kind)
    bench.bus.scan([FIRST])
    original = bench.hand.wire.write
    bench.hand.wire.write = lambda byte: byte != 0xEE and original(byte)
    for transfer in (
        Transfer(A, bytes([THRESHOLD, 0xEE])),
        Transfer(A, bytes([THRESHOLD, 0xEE]), 3),
    ):
        assert bench.bus.scan([WHO, transfer, WHO]) == [
            Reply(IDENTITY, True),
            NOT_ACKED,
            Reply(IDENTITY, True),
        ]


@every_bridge
def test_a_write_then_read_does_not_stop_between(make, kind):
    bench = make(kind)
    stops = []
    original, bench.hand.wire.stop = (
        bench.hand.wire.stop,
        lambda: (stops.append(1), original())[1],
    )
    bench.bus.scan([FIRST, WHO])
    assert len(stops) == 2


@every_bridge
def test_a_bridge_can_be_closed_twice_and_opened_again(make, kind):
    bench = make(kind)
    bench.bus.close()
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@every_bridge
def test_an_empty_scan_has_no_replies(make, kind):
    assert make(kind).bus.scan([]) == []


@pytest.mark.parametrize(
    ("kind", "transfers", "bytes_out", "bytes_in", "milliseconds"),
    [
        ("ft232h", 2, 1264, 70, 1.745),
        ("native", 8, 8, 42, 1.895),
    ],
)
def test_a_scan_of_six_sensors_takes_this_much_traffic_and_time(
    make, kind, transfers, bytes_out, bytes_in, milliseconds
):
    bench = make(kind)
    bench.bus.scan(SIX)
    traffic = bench.backend.traffic
    begun_ns = bench.clock.now_ns()
    traffic.transfers = traffic.bytes_out = traffic.bytes_in = 0
    assert all(reply.acked for reply in bench.bus.scan(SIX))
    assert (traffic.transfers, traffic.bytes_out, traffic.bytes_in) == (
        transfers,
        bytes_out,
        bytes_in,
    )
    assert bench.clock.now_ns() - begun_ns == round(1e6 * milliseconds)


# -- what goes over USB, byte by byte


ZEROS = "0" * 40


def conversation(bench: Bench) -> list[str]:
    """What goes over USB while a bridge is opened, scans and is freed: `>` to it, `<` from it.

    An endpoint or a control request, then the data without zeros at their end; `..` are 20 zeros.
    """
    lines: list[str] = []

    def noting(name: str) -> Callable[..., int]:
        carry = getattr(bench.backend, name)

        def noted(handle: object, *values: Any) -> int:
            length = int(carry(handle, *values))
            request = values[:4] if name == "ctrl_transfer" else values[:1]
            data = bytes(values[-2])[:length].rstrip(b"\0")
            arrow = "<" if request[0] & 0x80 else ">"
            words = [
                arrow,
                *(f"{one:x}" for one in request),
                data.hex().replace(ZEROS, ".."),
            ]
            lines.append(" ".join(words).rstrip())
            return length

        return noted

    bench.bus.close()
    for name in ("ctrl_transfer", "bulk_read", "bulk_write"):
        setattr(bench.backend, name, noting(name))
    bench.bus = bench.open()
    bench.bus.scan([FIRST, WHO, Transfer(ABSENT), Transfer(A, read=2)])
    bench.bus.clear()
    return lines


START, STOP = (
    "800303" * 4 + "800103" * 4 + "800003",
    "800003" * 4 + "800103" * 4 + "800303" * 4,
)
"""Of the FT232H (AN 108, AN 255): SDA falls, or rises, while SCL is high."""


def written(byte: int) -> str:
    """A byte out, SDA released, and the acknowledge bit in."""
    return f"110000{byte:02x}" + "800203" + "2200"


def read_from(address: int, length: int) -> str:
    """A repeated START, the bytes in, each acknowledged but for the last, and STOP."""
    begin = "800203" + START + written(address << 1 | 1)
    return begin + "200000130000800203" * (length - 1) + "2000001300ff800203" + STOP


def set_up(first: str, second: str) -> str:
    """Its own requests, then its setup and a look at the wiring, each with its mark."""
    sda = "800203" * 4 + "800003" * 4 + "81" + "800203" * 4 + "800303" * 4
    return f"""
> 40 0 0 1
> 40 0 1 1
> 40 0 2 1
> 40 9 1 1
> 40 b 0 1
> 40 b 200 1
> 40 0 1 1
> 40 0 2 1
< 81 3260
> 2 {first}87
< 81 3260fa{first}
> 2 8a978c9e070085863100800303800303800303800303
> 2 {second}{sda}87
< 81 3260fa{second}"""


CONVERSATION = f"""{set_up("ab", "aa")}
> 2 ab81{START}{written(0xE0)}{written(1)}{STOP}{START}{written(0x6A)}{written(0x0D)}\
{read_from(A, 3)}{START}{written(0x22)}{STOP}{read_from(A, 2)}8187
< 81 3260faab0700000000000149540102000007{set_up("aa", "ab")}
> 2 aa{("800203" * 4 + "800303" * 4) * 9}{STOP}8187
< 81 3260faaa07"""


def test_a_bridge_is_opened_asked_and_freed_with_these_bytes_and_answers_with_these(
    make,
):
    assert conversation(make("ft232h")) == CONVERSATION.split("\n")[1:]
