"""One finger, packet by packet: each reply that is no reading has its word."""

from __future__ import annotations

import pytest
from hazard_marks import CORRUPT_READING
from hypothesis import given
from hypothesis import strategies as st

from holdfast.drivers.bus import Reply
from holdfast.drivers.chips import driver_of
from holdfast.drivers.fingers import FingerState
from holdfast.drivers.layout import Finger
from holdfast.drivers.tmag5273.registers import LAYOUT, PACKET_BYTES, packet

ADDRESS = 0x35


@CORRUPT_READING.mark
@given(st.binary(min_size=PACKET_BYTES, max_size=PACKET_BYTES))
def test_a_status_whose_reserved_bits_are_set_is_no_packet_of_the_chip(data):
    spoilt = data[:-1] + bytes([data[-1] | 0x04])
    judged = FingerState(Finger(ADDRESS), driver_of("tmag5273")).judge(
        Reply(spoilt, acked=True), 0
    )
    assert judged[1] == "garbage"
    assert packet(spoilt).raw == packet(data).raw


# -- one finger, packet by packet


def plain(x: int = 5, status: int = 1, count: int = 0) -> Reply:
    return Reply(LAYOUT.pack(x, 6, 7, status | count << 5), acked=True)


def lively() -> FingerState:
    """A finger that was brought up at 0 and has converted twice by 1 ms."""
    state = FingerState(Finger(ADDRESS), driver_of("tmag5273"))
    state.brought_up(1, 0)
    assert [state.judge(plain(count=k), 500_000 * k)[1] for k in (1, 2)] == [
        "settling",
        "",
    ]
    assert state.settled
    return state


@CORRUPT_READING.mark
@pytest.mark.parametrize(
    ("reply", "why"),
    [
        (plain(32766), ""),
        (plain(32767), "saturated"),
        (plain(-32766), ""),
        (plain(-32767), "saturated"),
        (plain(-32768), "saturated"),
        (plain(status=0x05), "garbage"),
        (plain(status=0x09), "garbage"),
        (plain(status=0x11), "reset"),
        (plain(status=0x03), "diagnosis"),
        (Reply(bytes(7), acked=True), "garbage"),
        (Reply(b"\xff" * 7, acked=True), "garbage"),
        (Reply(bytes(6) + b"\x01", acked=True), "settling"),
        (Reply(b"", acked=False), "nack"),
        (Reply(bytes(6), acked=True), "nack"),
        (Reply(bytes(8), acked=True), "nack"),
    ],
)
def test_each_reply_that_is_no_reading_has_its_word(reply, why):
    state = lively()
    found, word = state.judge(reply, 2_000_000)
    assert word == why
    assert (found is None) == (why == "nack")
    assert state.needs_bring_up(word) == (
        why in ("garbage", "reset", "diagnosis", "missing")
    )


@pytest.mark.parametrize(("after_ns", "why"), [(20_000_000, ""), (20_000_001, "stale")])
def test_a_packet_that_repeats_is_stale_after_twenty_milliseconds(after_ns, why):
    state = lively()
    assert state.judge(plain(count=2), 1_000_000 + after_ns)[1] == why
    assert state.needs_bring_up("stale")
