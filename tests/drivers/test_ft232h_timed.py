"""Scans that the FT232H times itself: regular while the host is away, gaps counted."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
import pytest

from benchmarks.timed_scans import DeviceTimes, Kept, started
from holdfast.core.errors import BusStuck, DeviceLost, UsageError
from holdfast.drivers.bridges import open_virtual
from holdfast.drivers.bus import Transfer
from holdfast.drivers.ft232h_timed import TimedScan
from holdfast.drivers.hand import Hand
from holdfast.drivers.layout import LAYOUTS
from holdfast.drivers.virtual.faults import read_fault
from holdfast.drivers.virtual.ft232h import VirtualFt232h
from holdfast.drivers.virtual.usb_devices import AtOnce
from holdfast.drivers.virtual.virtual_hand import VirtualHand

PERIOD_NS = round(1e9 / 150)


def began(clock: DeviceTimes, scans: Sequence[TimedScan]) -> np.ndarray:
    """When the device really began these scans, the last that it began, ns."""
    times, planned = np.array(clock.began_ns), np.array([one.t_ns for one in scans])
    after = np.clip(np.searchsorted(times, planned), 1, len(times) - 1)
    return times[after - (planned - times[after - 1] < times[after] - planned)]


@pytest.mark.parametrize("n", [600, pytest.param(200_000, marks=pytest.mark.soak)])
def test_samples_are_regular_and_none_is_lost_while_the_host_is_away(n: int):
    bus, clock = started()
    bus.begin(bus.last, PERIOD_NS)
    scans = []
    for k in range(n):
        clock.spend(40_000_000 if k % 100 == 99 else 0)
        scans.append(bus.next())
    assert [one.number for one in scans] == list(range(n))
    assert all(reply.acked for one in scans for reply in one.replies)
    times = began(clock, scans)
    steps = np.abs(np.diff(times) - PERIOD_NS)
    assert steps.max() < 25_000, "the idle clocks come in steps of 20 us"
    assert (
        np.abs([one.t_ns - at for one, at in zip(scans, times, strict=True)]).max()
        < 700_000
    )
    assert abs(np.diff(times).mean() - PERIOD_NS) < 5_000


def test_what_the_chips_answer_is_what_a_plain_scan_reads():
    bus, _ = started()
    plain = bus.scan(bus.last)
    bus.begin(bus.last, PERIOD_NS)
    timed = bus.next().replies
    assert [len(one.data) for one in timed] == [len(one.data) for one in plain]
    assert [one.acked for one in timed] == [one.acked for one in plain]
    bus.end()
    assert all(one.acked for one in bus.scan(bus.last)), (
        "afterwards it is the plain driver again"
    )


def test_a_host_that_is_away_for_longer_than_the_queue_counts_what_it_lost():
    bus, clock = started()
    bus.begin(bus.last, PERIOD_NS, block=4)
    before = [bus.next() for _ in range(40)]
    clock.spend(500_000_000)
    after, came_ns = [], []
    for _ in range(60):
        after.append(bus.next())
        came_ns.append(clock.now_ns())
    numbers = [one.number for one in (*before, *after)]
    (gap,) = [step for step in np.diff(numbers) if step != 1]
    assert gap == pytest.approx(0.5e9 / PERIOD_NS - 8, abs=2)
    taken_ns = np.array(came_ns) - [one.t_ns for one in after]
    assert 1_000_000 < taken_ns[-20:].min() <= taken_ns[-20:].max() < 2_500_000


def scanned(bus: Kept, n: int) -> list[TimedScan]:
    return [bus.next() for _ in range(n)]


def with_fault(text: str) -> tuple[Kept, DeviceTimes]:
    clock = DeviceTimes()
    hand = VirtualHand(clock, seed=0, faults=[read_fault(text)])
    bus = Kept(
        open_virtual("ft232h", hand, 400_000).backend,
        now_ns=clock.now_ns,
        writer=AtOnce(),
    )
    driver = Hand(
        lambda: bus,
        LAYOUTS["mux"],
        now_ns=clock.now_ns,
        pause=lambda seconds: clock.spend(round(1e9 * seconds)),
    )
    driver.start()
    driver.read()
    bus.begin(bus.last, PERIOD_NS)
    return bus, clock


def test_a_finger_that_does_not_answer_costs_only_its_own_reply():
    bus, _ = with_fault("nack:3@1+60")
    acked = [[reply.acked for reply in bus.next().replies] for _ in range(300)]
    assert all(acked[0])
    assert acked[-1].count(False) == 1


@pytest.mark.parametrize(
    ("fault", "error"), [("stuck@1", BusStuck), ("unplug@1+60", DeviceLost)]
)
def test_a_bus_or_a_bridge_that_fails_is_raised(fault: str, error: type[Exception]):
    bus, _ = with_fault(fault)
    with pytest.raises(error):
        scanned(bus, 300)


def test_what_cannot_be_timed_is_refused():
    bus, _ = started()
    with pytest.raises(UsageError, match=r"cannot come every 1\.00 ms"):
        bus.begin(bus.last, 1_000_000)
    with pytest.raises(UsageError, match="blocks of at most 8 scans"):
        bus.begin(bus.last, PERIOD_NS, block=9)
    with pytest.raises(UsageError, match="do not fit the chip's memory"):
        bus.begin([Transfer(0x35, b"", 300)], PERIOD_NS)


@pytest.mark.parametrize("ppm", [-300, 300])
def test_a_chip_whose_clock_drifts_is_held_to_the_host_s_grid_slowly(
    ppm: int, monkeypatch: pytest.MonkeyPatch
):
    hz = VirtualFt232h._bus_hz
    monkeypatch.setattr(
        VirtualFt232h, "_bus_hz", lambda self: hz(self) * (1 + 1e-6 * ppm)
    )
    bus, clock = started()
    start_ns = clock.now_ns() + 100_000_000
    bus.begin(bus.last, PERIOD_NS, start_ns=start_ns)
    scans = scanned(bus, 3000)
    assert [one.number for one in scans] == list(range(3000))
    times = began(clock, scans)
    off_ns = times - (start_ns + np.arange(3000) * PERIOD_NS)
    assert np.abs(off_ns[200:]).max() < 400_000, "unheld it would be off by 6 ms"
    assert np.abs(np.diff(times) - PERIOD_NS).max() < 25_000
