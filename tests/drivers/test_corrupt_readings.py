"""What the chip's own CRC is for: flipped bits and two chips at one address never make a wrong
valid reading."""

from __future__ import annotations

import struct
from collections import deque
from typing import Any

import numpy as np
import pytest
from hand_bench import PERIOD_NS, Bench, started
from hazard_marks import CORRUPT_READING
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.errors import WrongDevice
from holdfast.drivers.bus import Bus, Reply
from holdfast.drivers.finger import (
    MOST_TEST_PACKETS,
    TEST_PACKETS,
    FingerState,
    PacketCheck,
)
from holdfast.drivers.layout import Finger
from holdfast.drivers.native_i2c import NativeI2C
from holdfast.drivers.tmag5273 import (
    LAYOUT,
    PACKET_BYTES,
    RESULTS,
    Setup,
    packet,
    packet_crc,
)
from holdfast.drivers.virtual.chip import Chip
from holdfast.drivers.virtual.native import VirtualI2cDev
from holdfast.drivers.virtual.virtual_hand import Noise, Track

ADDRESS = 0x35
DIFFERENT_UT = np.arange(18.0).reshape(1, 6, 3) * 1500.0
RECENT = 4
"""Conversions that a reading may come from: at 150 Hz three are made in a period."""


def packets(seed: int, count: int) -> list[bytes]:
    """Packets of a chip at ADDRESS, with noise in their last bits."""
    rng = np.random.default_rng(seed)
    mean = rng.integers(-20_000, 20_000, size=3)
    rows = [
        LAYOUT.pack(*(mean + rng.integers(-20, 20, size=3)), k % 8 << 5 | 1)
        for k in range(count)
    ]
    return [row + bytes([packet_crc(ADDRESS, row)]) for row in rows]


def wired_and(*sent: bytes) -> bytes:
    """What a master reads where chips talk at once."""
    return bytes(
        np.bitwise_and.reduce([np.frombuffer(one, dtype=np.uint8) for one in sent])
    )


def trusted() -> PacketCheck:
    check = PacketCheck()
    assert [check.believes(ADDRESS, one) for one in packets(0, TEST_PACKETS)] == [
        False
    ] * TEST_PACKETS
    assert check.trusted
    return check


# -- the check of one chip's packets


def test_packets_are_believed_once_eight_different_ones_have_fitted():
    check = PacketCheck()
    result = [check.believes(ADDRESS, one) for one in packets(0, 12)]
    assert result == [False] * TEST_PACKETS + [True] * 4


def test_the_same_packet_again_tests_nothing():
    check = PacketCheck()
    one = packets(0, 1)[0]
    assert not any(check.believes(ADDRESS, one) for _ in range(100))
    assert not check.trusted


@CORRUPT_READING.mark
@given(st.sets(st.integers(0, 63), min_size=1, max_size=3), st.integers(0, 1000))
def test_one_to_three_flipped_bits_are_always_found(bits, seed):
    good = packets(seed, 1)[0]
    spoilt = int.from_bytes(good, "big")
    for bit in bits:
        spoilt ^= 1 << bit
    assert not trusted().believes(ADDRESS, spoilt.to_bytes(8, "big"))


@CORRUPT_READING.mark
@pytest.mark.parametrize("bit", range(7))
def test_a_packet_of_the_chip_at_a_neighbouring_address_does_not_fit(bit):
    assert not trusted().believes(ADDRESS ^ 1 << bit, packets(0, 1)[0])


def test_after_one_packet_that_does_not_fit_two_in_a_row_must():
    check = trusted()
    good = packets(1, 4)
    assert not check.believes(ADDRESS, good[0][:-1] + b"\0")
    assert [check.believes(ADDRESS, one) for one in good] == [False, True, True, True]


def test_after_two_that_do_not_fit_the_test_begins_anew():
    check = trusted()
    for one in packets(1, 2):
        assert not check.believes(ADDRESS, one[:-1] + b"\0")
    assert check.failures == 1
    assert [check.believes(ADDRESS, one) for one in packets(2, 10)] == [
        False
    ] * TEST_PACKETS + [True] * 2
    assert check.failures == 0


@pytest.mark.parametrize("offset", [0x09, 0x2B, 0xFF])
def test_a_chip_whose_crc_begins_with_another_seed_is_checked_all_the_same(offset):
    """TI E2E 1200004 and 1558871: off by the same bits in every packet."""
    check = PacketCheck()
    sent = [one[:-1] + bytes([one[-1] ^ offset]) for one in packets(0, 20)]
    assert [check.believes(ADDRESS, one) for one in sent] == [False] * TEST_PACKETS + [
        True
    ] * 12
    assert not check.believes(ADDRESS, packets(0, 21)[-1])


@pytest.mark.parametrize("last", [0x00, 0xFF, 0x31])
def test_a_chip_that_sends_no_crc_is_known_by_a_byte_that_never_changes(last):
    check = PacketCheck()
    for one in packets(0, TEST_PACKETS):
        assert not check.believes(ADDRESS, one[:-1] + bytes([last]))
    assert check.absent


@CORRUPT_READING.mark
def test_two_chips_at_one_address_never_pass_the_test():
    fits = tests = 0
    for seed in range(300):
        check = PacketCheck()
        pairs = zip(
            packets(2 * seed, MOST_TEST_PACKETS),
            packets(2 * seed + 1, MOST_TEST_PACKETS),
            strict=True,
        )
        for one in (wired_and(*pair) for pair in pairs):
            check.believes(ADDRESS, one)
            fits += one[-1] == packet_crc(ADDRESS, one[:-1])
            tests += 1
        assert not check.trusted
        assert not check.absent
    assert 0 < fits < 0.03 * tests  # one alone does pass, now and then


# -- the hand


def second_chip(bench: Bench, finger: int, version: int = 1) -> Chip:
    """Another chip of the same version at a finger's address, behind the same channel."""
    virtual = bench.virtual
    first = bench.virtual.chips[finger - 1]
    other = Chip(
        finger,
        first.factory_address,
        version,
        lambda now_s: [9000.0, -7000.0, 12000.0],
        bench.clock,
        virtual.faults,
        seed=99,
    )
    next(channel for channel in virtual.mux.channels if first in channel).append(other)
    return other


@CORRUPT_READING.mark
@pytest.mark.parametrize("version", [1, 2])
def test_two_chips_at_one_address_are_noticed_at_the_start(version):
    bench = Bench(track=Track(np.array([0.0]), DIFFERENT_UT))
    second_chip(bench, 1, version)
    with pytest.raises(WrongDevice, match=r"two chips at one address|two at once"):
        bench.hand.start()


@CORRUPT_READING.mark
def test_a_second_chip_that_appears_while_the_hand_is_read_makes_its_finger_invalid():
    bench = started(track=Track(np.array([0.0]), DIFFERENT_UT))
    assert all(reading.valid.all() for reading in bench.read_for(0.2))
    twin = second_chip(bench, 1)
    for register, value in Setup(crc=True).registers():
        twin.addressed(ADDRESS, read=False)
        assert all(twin.write(byte) for byte in (register, value))
        twin.stop()
    readings = bench.read_for(2.0)
    assert not any(reading.valid[0] for reading in readings)
    assert all(reading.valid[1:].all() for reading in readings)


def test_the_crc_option_decides_whether_a_chip_without_a_crc_is_read_unchecked_or_refused(
    monkeypatch,
):
    def without_crc(chip: Any, address: int) -> bytes | None:
        sent = burst(chip, address)
        return sent and sent[:PACKET_BYTES]

    burst = Chip._burst
    monkeypatch.setattr(Chip, "_burst", without_crc)
    auto = started()
    off = started(crc="off")
    assert auto.messages == [
        f"finger {k}: sends no CRC, its readings are unchecked (crc=auto)"
        for k in range(1, 7)
    ]
    assert off.messages == []
    for bench in (auto, off):
        assert all(reading.valid.all() for reading in bench.read_for(0.1))
        assert [sensor["crc"] for sensor in bench.hand.about()["sensors"]] == [
            False
        ] * 6
    with pytest.raises(WrongDevice, match="crc=auto"):
        started(crc="on")


def remember(bench: Bench) -> list[deque[tuple[float, ...]]]:
    """The last results that each chip has really converted, from now on."""
    recent: list[deque[tuple[float, ...]]] = [
        deque(maxlen=RECENT) for _ in bench.virtual.chips
    ]

    def watched(chip: Any, of: deque[tuple[float, ...]]) -> None:
        convert = chip._convert

        def converted(middle_s: float) -> None:
            convert(middle_s)
            of.append(struct.unpack_from(">3h", chip._bytes, RESULTS))

        chip._convert = converted

    for chip, of in zip(bench.virtual.chips, recent, strict=True):
        watched(chip, of)
    return recent


class OnTheBoard(Bench):
    """The same hand on the board's own bus, whose emulation takes a third of the time."""

    def __post_init__(self) -> None:
        super().__post_init__()
        self.device = VirtualI2cDev(self.virtual).__enter__()

    def open_bus(self) -> Bus:
        return NativeI2C(1)


def wrong_and_valid(scans: int, crc: Any = "auto") -> tuple[int, int]:
    """Valid readings that no chip of their finger has converted, and valid readings, with one bit
    in 10^4 flipped."""
    bench = OnTheBoard(track=Track(np.array([0.0]), DIFFERENT_UT), crc=crc)
    bench.virtual.wire.noise = Noise(1e-4)
    try:
        return _counted(bench, scans)
    finally:
        bench.device.__exit__(None, None, None)


def _counted(bench: OnTheBoard, scans: int) -> tuple[int, int]:
    recent = remember(bench)
    bench.hand.start()
    scale = 1e3 / 32768.0 * bench.hand.setup.range_mt(1)
    start_ns = bench.clock.now_ns()
    wrong = 0
    valid = 0
    for k in range(scans):
        bench.clock.wait_until(start_ns + k * PERIOD_NS)
        reading = bench.hand.read()
        valid += int(reading.valid.sum())
        for finger in np.flatnonzero(reading.valid):
            wrong += (
                tuple(np.rint(reading.field_ut[finger] / scale)) not in recent[finger]
            )
        bench.messages.clear()
    return wrong, valid


@CORRUPT_READING.mark
def test_no_reading_is_wrong_and_valid_on_a_wire_that_flips_one_bit_in_ten_thousand():
    wrong, valid = wrong_and_valid(2_000)
    assert wrong == 0
    assert 10_000 < valid < 12_000


def test_without_the_crc_such_a_wire_does_make_wrong_valid_readings():
    assert wrong_and_valid(500, "off")[0] > 3


@pytest.mark.soak
def test_no_finger_of_a_million_scans_is_wrong_and_valid_on_such_a_wire():
    wrong, valid = wrong_and_valid(1_000_000)
    assert wrong == 0
    assert valid > 0.95 * 6_000_000


@given(st.binary(min_size=PACKET_BYTES, max_size=PACKET_BYTES))
def test_a_status_whose_reserved_bits_are_set_is_no_packet_of_the_chip(data):
    spoilt = data[:-1] + bytes([data[-1] | 0x04])
    assert (
        FingerState(Finger(ADDRESS), Setup()).judge(Reply(spoilt, acked=True), 0)[1]
        == "garbage"
    )
    assert packet(spoilt).raw == packet(data).raw


# -- one finger, packet by packet


def plain(x: int = 5, status: int = 1, count: int = 0) -> Reply:
    return Reply(LAYOUT.pack(x, 6, 7, status | count << 5), acked=True)


def lively(**setup: Any) -> FingerState:
    """A finger that was brought up at 0 and has converted twice by 1 ms."""
    state = FingerState(Finger(ADDRESS), Setup(**setup))
    state.brought_up(1, 0)
    assert [state.judge(plain(count=k), 500_000 * k)[1] for k in (1, 2)] == [
        "settling",
        "",
    ]
    assert state.settled
    return state


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
        (None, "missing"),
    ],
)
def test_each_reply_that_is_no_reading_has_its_word(reply, why):
    state = lively()
    found, word = state.judge(reply, 2_000_000)
    assert word == why
    assert (found is None) == (why in ("nack", "missing"))
    assert state.needs_bring_up(word) == (
        why in ("garbage", "reset", "diagnosis", "missing")
    )


@pytest.mark.parametrize(("after_ns", "why"), [(20_000_000, ""), (20_000_001, "stale")])
def test_a_packet_that_repeats_is_stale_after_twenty_milliseconds(after_ns, why):
    state = lively()
    assert state.judge(plain(count=2), 1_000_000 + after_ns)[1] == why
    assert state.needs_bring_up("stale")


@pytest.mark.parametrize(
    ("after_ns", "why"), [(20_000_000, ""), (20_000_001, "settling")]
)
def test_after_a_missing_acknowledge_and_a_longer_pause_a_chip_may_have_slept(
    after_ns, why
):
    state = lively()
    assert state.judge(Reply(b"", acked=False), 2_000_000)[1] == "nack"
    assert not state.needs_bring_up("nack")
    assert state.judge(plain(count=3), 1_000_000 + after_ns)[1] == why
    for _ in range(2):
        state.judge(Reply(b"", acked=False), 40_000_000)
    assert state.needs_bring_up("nack")
    state.begin(41_000_000)
    assert (state.nacks, state.ready, state.tried_ns) == (0, False, 41_000_000)


def test_a_finger_is_read_as_its_chip_is_set_up():
    moved = Finger(ADDRESS, 0, 0x50)
    transfers = [
        FingerState(moved, setup).transfer
        for setup in (Setup(), Setup(burst=True), Setup(crc=True))
    ]
    assert [(one.address, one.write, one.read) for one in transfers] == [
        (0x50, bytes([RESULTS]), 7),
        (0x50, b"", 7),
        (0x50, b"", 8),
    ]
    fresh = FingerState(moved, Setup(crc=True))
    assert (fresh.tried_ns, fresh.version, fresh.settled) == (-50_000_000, 1, True)


def test_a_test_of_a_crc_fails_after_24_packets_and_a_missing_one_shows_after_8():
    check = PacketCheck()
    wrong = [one[:-1] + bytes([k]) for k, one in enumerate(packets(3, 48))]
    failures = []
    for one in wrong:
        assert not check.believes(ADDRESS, one)
        failures.append(check.failures)
    assert failures == [0] * 23 + [1] * 24 + [2]
    check = PacketCheck()
    absent = []
    for one in packets(4, 8):
        check.believes(ADDRESS, one[:-1] + b"\0")
        absent.append(check.absent)
    assert absent == [False] * 7 + [True]


@pytest.mark.parametrize(("failures", "again"), [(0, False), (1, False), (2, True)])
def test_a_test_that_failed_since_the_bring_up_calls_for_another(failures, again):
    state = FingerState(Finger(ADDRESS), Setup(crc=True))
    state.check.failures = 1
    state.brought_up(1, 0)
    state.check.failures = failures
    assert state.needs_bring_up("crc") == again
    assert not state.needs_bring_up("settling")
