"""A hand that starts and comes back: on a bus held low, at slow scans, behind a bridge that stays
halted or failed."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest
from hand_bench import Bench, started
from hazard_marks import BRIDGE_FAULT, SLOW_REPAIR, STUCK_BUS, WIRING

from holdfast.core.errors import BusStuck, DeviceError, TransferFailed
from holdfast.drivers.bus import Transfer
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.virtual.ft232h import (
    IN_ENDPOINT,
    OUT_ENDPOINT,
    SCL,
    SDA_IN,
    VirtualFt232h,
    stall,
)
from holdfast.drivers.virtual.usb_backend import VirtualBackend

ONE = [Transfer(0x70, b"\x01"), Transfer(0x35, b"\x0d", 3)]
IDENTITY = bytes([0x01, 0x49, 0x54])


# -- repairs at slow scans


@SLOW_REPAIR.mark
@pytest.mark.parametrize(
    "fault", ["nack:3@1+0.3", "por:3@1", "sleep:3@1", "frozen:3@1+0.3", "diag:3@1+0.3"]
)
@pytest.mark.parametrize("rate_hz", [10.0, 4.0, 1.0])
def test_a_repaired_finger_is_valid_from_its_second_new_reading_on(fault, rate_hz):
    readings = started(fault).read_for(8.0, rate_hz)
    after = [reading.why[2] for reading in readings if reading.t_ns > 1.31e9]
    assert after.index("") <= 4  # read, brought up, read once, and again
    assert set(after[after.index("") :]) == {""}
    assert all(reading.valid[[0, 1, 3, 4, 5]].all() for reading in readings)


@SLOW_REPAIR.mark
def test_a_finger_that_is_gone_for_good_keeps_no_other_from_its_repair():
    readings = started("nack:1@1+100", "por:4@2").read_for(6.0, rate_hz=10.0)
    assert [bool(reading.valid[3]) for reading in readings[-10:]] == [True] * 10
    assert not readings[-1].valid[0]


# -- a bus that is held low


@STUCK_BUS.mark
def test_a_hand_starts_on_a_bus_that_is_held_low_at_whatever_moment_of_the_start():
    bench = started()
    lasts_s = 1e-9 * bench.clock.now_ns()
    for k in range(15):
        bench = started(f"stuck@{k * lasts_s / 15:.6f}")
        assert bench.read_for(0.02)[-1].valid.all()


class HeldScl(VirtualFt232h):
    """A bridge whose SCL a chip can hold low."""

    held = False

    def _levels(self) -> int:
        return super()._levels() & ~SCL if self.held else super()._levels()


class Untied(VirtualFt232h):
    """A bridge whose AD2 is tied to nothing: SDA always reads high, though AD1 pulls it."""

    def _levels(self) -> int:
        return super()._levels() | SDA_IN


def bridge(device: type[VirtualFt232h]) -> tuple[Bench, Any]:
    """A hand's bench before another bridge."""
    bench = Bench()
    emulated = device(bench.virtual)
    bench.backend = VirtualBackend(emulated)
    return bench, emulated


@STUCK_BUS.mark
def test_scl_held_low_is_reported_once_and_every_reading_is_invalid_until_it_is_released():
    bench, emulated = bridge(HeldScl)
    bench.hand.start()
    bench.read_for(0.1)
    emulated.held = True
    assert not any(reading.valid.any() for reading in bench.read_for(2.0))
    about_bus = [line for line in bench.messages if not line.startswith("finger")]
    assert len(about_bus) == 2  # what is wrong, and that nine clocks do not help
    emulated.held = False
    assert bench.read_for(0.5)[-1].valid.all()
    assert "ft232h: back" in bench.messages


@STUCK_BUS.mark
def test_a_bus_that_cannot_be_freed_starts_no_hand_and_says_why():
    bench, emulated = bridge(HeldScl)
    emulated.held = True
    with pytest.raises(BusStuck, match="SCL still low"):
        bench.hand.start()


# -- wiring and options


@WIRING.mark
def test_ad1_and_ad2_that_are_not_tied_together_are_named():
    bench, _ = bridge(Untied)
    with pytest.raises(BusStuck, match="AD1 and AD2 are not tied together"):
        bench.hand.start()


# -- the bridge


@BRIDGE_FAULT.mark
@pytest.mark.parametrize("endpoint", [OUT_ENDPOINT, IN_ENDPOINT])
def test_an_endpoint_that_stays_halted_is_cleared_and_the_next_scan_is_right(
    monkeypatch, endpoint
):
    """As a device keeps it, until the host clears it."""
    bench, halted = Bench(), set[int]()

    def stopped_where_halted(transfer: Callable[..., int]) -> Callable[..., int]:
        def carry(handle: object, ep: int, *rest: object) -> int:
            if ep in halted:
                raise stall()
            return transfer(handle, ep, *rest)

        return carry

    backend = bench.backend
    for name in ("bulk_write", "bulk_read"):
        wrapped = stopped_where_halted(getattr(backend, name))
        monkeypatch.setattr(backend, name, wrapped)
    monkeypatch.setattr(backend, "clear_halt", lambda handle, ep: halted.discard(ep))
    bus = bench.open_bus()
    halted.add(endpoint)
    with pytest.raises(TransferFailed, match="stall"):
        bus.scan(ONE)
    assert bus.scan(ONE)[1].data == IDENTITY


@BRIDGE_FAULT.mark
@pytest.mark.parametrize(
    "faults",
    [
        tuple(f"nack:{k}@0+100" for k in range(1, 7)),
        ("wrong:2@0+100",),
        ("late@0.01+9",),
    ],
)
def test_a_start_that_fails_gives_the_bridge_back(faults):
    bench = Bench(faults=faults)
    with pytest.raises(DeviceError):
        bench.hand.start()
    bench.clock.wait_until(20_000_000_000)
    bench.open_bus().close()  # an interface that is still claimed would be busy


def test_an_unfinished_command_of_an_earlier_program_is_cleared_before_the_next_one():
    bench = Bench()
    bus = bench.open_bus()
    assert isinstance(bus, Ft232h)
    bus._doubtful = True  # as after a failure
    # a write of 65 bytes, of which none came
    bench.backend.device.write(OUT_ENDPOINT, b"\x11\x40\x00")
    assert bus.scan(ONE)[1].data == IDENTITY


def test_bytes_beyond_those_asked_for_are_a_transfer_that_failed() -> None:
    bench = Bench()
    bus = bench.open_bus()
    assert isinstance(bus, Ft232h)
    device = bench.backend.device
    assert isinstance(device, VirtualFt232h)
    device._answers += b"\x00" * 7
    with pytest.raises(TransferFailed, match=r"\d+ bytes arrived, not \d+"):
        bus.scan(ONE)
    assert bus.scan(ONE)[1].data == IDENTITY
