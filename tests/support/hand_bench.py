"""A virtual hand on an emulated FT232H with its driver, for the tests of what the hand does when
something fails."""

from __future__ import annotations

from dataclasses import dataclass, field

from holdfast.core.source import SourceReading
from holdfast.drivers.bus import Bus
from holdfast.drivers.chips import DEFAULT_CHIP, driver_of, emulation_of
from holdfast.drivers.ft232h import Ft232h
from holdfast.drivers.hand import Hand
from holdfast.drivers.layout import read_layout
from holdfast.drivers.virtual.faults import VirtualClock, read_fault
from holdfast.drivers.virtual.ft232h import VirtualFt232h
from holdfast.drivers.virtual.usb_backend import VirtualBackend
from holdfast.drivers.virtual.virtual_hand import Track, VirtualHand

PERIOD_NS = round(1e9 / 150)


@dataclass
class Bench:
    """A virtual hand, its driver, and the driver's messages."""

    faults: tuple[str, ...] = ()
    track: Track | None = None
    layout: str = "mux"
    on_wire: str | None = None
    chip: str = DEFAULT_CHIP
    clock: VirtualClock = field(default_factory=VirtualClock)

    def __post_init__(self) -> None:
        driver = driver_of(self.chip)
        self.virtual = VirtualHand(
            self.clock,
            track=self.track,
            places=read_layout(self.on_wire or self.layout, driver.addresses),
            emulation=emulation_of(self.chip),
            seed=0,
            faults=[read_fault(one) for one in self.faults],
        )
        self.backend = VirtualBackend(VirtualFt232h(self.virtual))
        self.messages: list[str] = []
        self.hand = Hand(
            self.open_bus,
            read_layout(self.layout, driver.addresses),
            chip=driver,
            now_ns=self.clock.now_ns,
            pause=lambda seconds: self.clock.spend(round(1e9 * seconds)),
            say=self.messages.append,
        )

    def open_bus(self) -> Bus:
        """A driver on the bridge, opened."""
        return Ft232h(self.backend)

    def read_for(self, seconds: float, rate_hz: float = 150.0) -> list[SourceReading]:
        start_ns = self.clock.now_ns()
        readings = []
        for k in range(round(rate_hz * seconds)):
            self.clock.wait_until(start_ns + round(1e9 * k / rate_hz))
            readings.append(self.hand.read())
        return readings


def started(*faults: str, **options: object) -> Bench:
    bench = Bench(faults=faults, **options)  # type: ignore[arg-type]
    bench.hand.start()
    return bench


def bad(
    readings: list[SourceReading], finger: int | None = None
) -> list[SourceReading]:
    return [
        r
        for r in readings
        if not (r.valid.all() if finger is None else r.valid[finger - 1])
    ]
