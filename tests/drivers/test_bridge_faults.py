"""Every bridge when something fails: a transfer, a late reply, an unplugged cable, a bus that is
held low."""

from __future__ import annotations

import pytest
from bridge_bench import (
    FIRST,
    IDENTITY,
    SIX,
    THRESHOLD,
    WHO,
    A,
    B,
    every_bridge,
    every_usb_bridge,
)

from holdfast.core.errors import BusStuck, DeviceLost, DeviceNotFound, TransferFailed
from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.virtual.faults import Fault


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


# -- the emulated bus


# -- the emulated board's bus
