"""Every bridge with its driver over a virtual device, and transfers that tests ask for."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

import pytest
from virtual_i2c import VirtualI2cDev

from holdfast.drivers.bus import Bus, Transfer
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.native_i2c import NativeI2C
from holdfast.drivers.tmag5273.registers import (
    FACTORY_ADDRESSES,
    PACKET_BYTES,
    REGISTERS,
    RESULTS,
)
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.drivers.virtual.ft232h import VirtualFt232h
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.virtual_hand import VirtualHand

A, B, C, D = FACTORY_ADDRESSES
ABSENT = 0x11
ID = REGISTERS["DEVICE_ID"].address
IDENTITY = bytes([0x01, 0x49, 0x54])
FIRST, SECOND = Transfer(0x70, bytes([1])), Transfer(0x70, bytes([2]))
WHO = Transfer(A, bytes([ID]), 3)
THRESHOLD = REGISTERS["X_THR_CONFIG"].address
SIX = (
    FIRST,
    *(Transfer(a, bytes([RESULTS]), PACKET_BYTES) for a in (A, B, C, D)),
    SECOND,
    *(Transfer(a, bytes([RESULTS]), PACKET_BYTES) for a in (A, B)),
)
ON_USB = ("ft232h",)
ALL = (*ON_USB, "native")


class Bench:
    """A virtual hand on a bridge of its own. kind: one of ALL."""

    def __init__(self, kind: str, **options: Any) -> None:
        self.clock = VirtualClock()
        self.hand = VirtualHand(self.clock, **options)
        self.device: VirtualFt232h | None = None
        self.backend: Any
        self.open: Callable[[], Bus]
        if kind == "native":
            self.backend = VirtualI2cDev(self.hand).__enter__()
            self.open = lambda: NativeI2C(1)
        else:
            self.device = VirtualFt232h(self.hand)
            self.backend = VirtualBackend(self.device)
            self.open = lambda: Ft232h(self.backend)
        self.bus: Bus = self.open()

    def end(self) -> None:
        self.bus.close()
        if isinstance(self.backend, VirtualI2cDev):
            self.backend.__exit__(None, None, None)

    def wait_s(self, duration_s: float) -> None:
        self.clock.spend(round(1e9 * duration_s))


Make = Callable[..., Bench]


@pytest.fixture
def make() -> Iterator[Make]:
    """Benches that are taken apart in the end, the last first."""
    made: list[Bench] = []

    def one(kind: str, **options: Any) -> Bench:
        made.append(Bench(kind, **options))
        return made[-1]

    yield one
    for bench in reversed(made):
        bench.end()


every_bridge = pytest.mark.parametrize("kind", ALL)
every_usb_bridge = pytest.mark.parametrize("kind", ON_USB)
