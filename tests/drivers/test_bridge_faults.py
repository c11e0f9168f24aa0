"""Every bridge when something fails: a transfer, a late reply, an unplugged cable, a bus that is
held low."""

from __future__ import annotations

import pytest
from bridge_bench import (
    ABSENT,
    CANNOT_CLOCK,
    FIRST,
    ID,
    IDENTITY,
    SIX,
    THRESHOLD,
    TINY,
    WHO,
    A,
    B,
    every_bridge,
    every_usb_bridge,
)

from holdfast.core.errors import BusStuck, DeviceLost, DeviceNotFound, TransferFailed
from holdfast.drivers.bus import NOT_ACKED, Reply, Transfer
from holdfast.drivers.mcp2221 import TIMEOUT_MS, Mcp2221
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.faults import Fault
from holdfast.drivers.virtual.mcp2221 import VirtualMcp2221
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.virtual_hand import VirtualHand


@every_bridge
@pytest.mark.parametrize("fault", ["stall", "late", "short"])
@pytest.mark.parametrize("during", [0.0, 0.3, 0.6, 0.9])
def test_a_bridge_that_fails_says_so_and_the_next_scan_is_right(
    make, kind, fault, during
):
    """during: how far into a scan it begins, as a part of one."""
    healthy = make(kind)
    begun_ns = healthy.clock.now_ns()
    healthy.bus.scan(SIX)
    scan_s = 1e-9 * (healthy.clock.now_ns() - begun_ns)
    bench = make(kind, faults=[Fault(fault, 1 + during * scan_s, 0.5)])
    bench.clock.wait_until(1_000_000_000)
    before = [FIRST, WHO, *SIX[2:5], Transfer(A, bytes([THRESHOLD]), 1), *SIX[5:]]
    expected = BusStuck if (kind, fault) == ("native", "late") else TransferFailed
    with pytest.raises(expected):
        bench.bus.scan(before)
    bench.clock.wait_until(3_000_000_000)
    for _ in range(2):
        assert bench.bus.scan([FIRST, WHO, Transfer(B, bytes([THRESHOLD]), 1)])[1:] == [
            Reply(IDENTITY, acked=True),
            Reply(b"\0", acked=True),
        ]


@every_usb_bridge
def test_a_late_reply_never_answers_the_next_question(make, kind):
    """Registers hold their own number, so that a reply says which question it answers."""
    numbered = [Transfer(A, bytes([register, register])) for register in range(4, 8)]
    questions = [Transfer(A, bytes([register]), 1) for register in range(4, 8)]
    for begins_ms in range(0, 60, 5):
        bench = make(kind, faults=[Fault("late", 1 + 1e-3 * begins_ms, 0.004)])
        bench.bus.scan([FIRST, *numbered])
        bench.clock.wait_until(1_000_000_000)
        for _ in range(20):
            try:
                replies = bench.bus.scan(questions)
            except TransferFailed:
                continue
            assert [reply.data for reply in replies] == [
                bytes([register]) for register in range(4, 8)
            ]
        assert bench.bus.scan(questions)[0].data == bytes([4])


class SlowMcp2221(VirtualMcp2221):
    """Replies come when they come: late_ns after the command, once for each command named, and in
    order."""

    def __init__(self, hand: VirtualHand, slow: int) -> None:
        self.queue: list[tuple[int, bytes]] = []
        self.slow = slow
        self.late_ns = 0
        super().__init__(hand)

    def write(self, endpoint: int, data: bytes) -> None:
        super().write(endpoint, data)
        late_ns = self.late_ns if data[0] == self.slow else 0
        self.late_ns -= late_ns
        self.queue.append((self.hand.clock.now_ns() + late_ns, self._reply))

    def read(self, endpoint: int, length: int) -> bytes:
        self.hand.clock.spend(1_500_000)
        return (
            self.queue.pop(0)[1]
            if self.queue and self.queue[0][0] <= self.hand.clock.now_ns()
            else b""
        )


@pytest.mark.parametrize("slow", [0x10, 0x40, 0x93, 0x94])
@pytest.mark.parametrize("late_ms", [1, 4, 7, 10, 15, 58, 150])
def test_a_reply_that_comes_after_the_late_ones_were_read_away_answers_nothing_either(
    slow, late_ms
):
    """late_ms: after the driver has given up."""
    clock = VirtualClock()
    hand = VirtualHand(clock)
    device = SlowMcp2221(hand, slow)
    bus = Mcp2221(VirtualBackend(device, clock, hand.faults, hand.power_off))
    bus.scan(
        [FIRST, *(Transfer(A, bytes([register, register])) for register in range(4, 8))]
    )
    questions = [Transfer(A, bytes([register]), 1) for register in range(4, 8)]
    device.late_ns = 1_000_000 * (TIMEOUT_MS + late_ms)
    failed = 0
    for _ in range(9):
        try:
            replies = bus.scan(questions)
        except TransferFailed:
            failed += 1
            continue
        assert [reply.data for reply in replies] == [
            bytes([register]) for register in range(4, 8)
        ]
    assert 0 < failed < 6
    bus.close()


@every_bridge
def test_an_unplugged_bridge_is_lost_and_found_again(make, kind):
    bench = make(kind, faults=[Fault("unplug", 1, 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_500_000_000)
    with pytest.raises(DeviceLost):
        bench.bus.scan([FIRST, WHO])
    with pytest.raises(DeviceNotFound):
        bench.open()
    bench.clock.wait_until(2_500_000_000)
    with pytest.raises(DeviceLost):
        bench.bus.scan([FIRST, WHO])
    bench.bus.close()
    bench.bus = bench.open()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize("kind", CANNOT_CLOCK)
def test_a_bus_that_stays_held_low_cannot_be_cleared(make, kind):
    bench = make(kind, faults=[Fault("stuck", 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_000_000_000)
    if kind in TINY:
        assert bench.bus.scan([FIRST, WHO]) == [NOT_ACKED, NOT_ACKED]
    else:
        with pytest.raises(BusStuck):
            bench.bus.scan([FIRST, WHO])
    with pytest.raises(BusStuck, match="next:"):
        bench.bus.clear()


@pytest.mark.parametrize("kind", ["avr", "pico"])
def test_a_firmware_that_swings_the_pins_itself_frees_the_bus_without_knowing(
    make, kind
):
    bench = make(kind, faults=[Fault("stuck", 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_000_000_000)
    assert bench.bus.scan([Transfer(A, bytes([ID]), 3)])[0].data != IDENTITY
    bench.bus.clear()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@pytest.mark.parametrize("kind", CANNOT_CLOCK)
def test_a_bus_that_is_let_go_carries_again(make, kind):
    bench = make(kind, faults=[Fault("stuck", 1)])
    bench.bus.scan([FIRST, WHO])
    bench.clock.wait_until(1_000_000_000)
    bench.hand.suffer()
    with pytest.raises(BusStuck):
        bench.bus.clear()
    while bench.hand.wire.held_low:
        bench.hand.wire.clock()
    if kind != "native":
        bench.bus.clear()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY


@every_usb_bridge
def test_clearing_a_bus_that_is_free_does_no_harm(make, kind):
    bench = make(kind)
    bench.bus.clear()
    bench.bus.scan([FIRST, Transfer(ABSENT, b"\0")])
    bench.bus.clear()
    assert bench.bus.scan([FIRST, WHO])[1].data == IDENTITY
