"""What is on one bus and how fast it can be read: the findings of `holdfast scan`."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from holdfast.drivers.bus import Bus, Transfer
from holdfast.drivers.layout import (
    enable_channels,
    masks_of,
    muxes_of,
    read_layout,
)
from holdfast.drivers.scanning import BusDevice, as_layout, look_at
from holdfast.drivers.tmag5273 import PACKET_BYTES, RESULTS

TIMED_SCANS = 20
MODEL_RATES_HZ = (300.0, 150.0, 100.0, 50.0)
SPARE = 0.8
"""Largest share of a period that a scan may take: the rest is for the model and for delays."""


@dataclass(frozen=True)
class ScannedBus:
    """What is on one bus. layout: of its sensors, None without one.

    scan_s: median time of a scan of all sensors. model_hz: the fastest model that this serves, None
    where it serves none.
    """

    url: str
    devices: list[BusDevice]
    layout: str | None = None
    scan_s: float | None = None
    model_hz: float | None = None

    def lines(self) -> list[str]:
        """A line for each device (where, what it is, what is wrong), then the rate."""
        several = sum(device.kind == "mux" for device in self.devices) > 1
        width = 30 if several else 18
        lines = [self.url]
        for device in self.devices:
            place = f"{device.address:#04x}"
            if device.channel is not None:
                place = f"channel {device.channel}, {place}"
                if several:
                    place = f"mux {device.mux:#04x}, {place}"
            found = f"{device.what:<28}{device.trouble}"
            lines.append(f"  {place:<{width}}{found}".rstrip())
        if self.layout is None or self.scan_s is None:
            return [
                *lines,
                "  no sensor: power, SDA and SCL swapped, or pull-ups missing?",
            ]
        count = len(self.layout.split(","))
        order = "put them in the order of the fingers"
        lines.append(f"  {count} sensors: layout={self.layout} ({order})")
        rate = f"a scan takes {1e3 * self.scan_s:.2f} ms ({1.0 / self.scan_s:.0f} Hz)"
        serves = f"serves no model, {MODEL_RATES_HZ[-1]:g} Hz needs another bridge"
        if self.model_hz is not None:
            serves = f"serves a model of {self.model_hz:g} Hz"
        return [*lines, f"  {rate}: {serves}"]


def survey(
    url: str, bus: Bus, named: frozenset[int], sleep: Callable[[float], None]
) -> ScannedBus:
    """Look at an open bus, and time its sensors. named: addresses that a layout names.

    Raises a DeviceError.
    """
    devices = look_at(bus, sleep, named)
    layout = as_layout(devices)
    if not layout:
        return ScannedBus(url, devices)
    scan_s = median_scan_s(bus, layout)
    for rate_hz in MODEL_RATES_HZ:
        if scan_s * rate_hz < SPARE:
            return ScannedBus(url, devices, layout, scan_s, rate_hz)
    return ScannedBus(url, devices, layout, scan_s)


def median_scan_s(bus: Bus, layout: str) -> float:
    """The time of one scan of these sensors."""
    transfers, behind = [], frozenset[tuple[int, int]]()
    fingers = read_layout(layout)
    for finger in fingers:
        if finger.behind not in (frozenset(), behind):
            behind = finger.behind
            for mux, mask in masks_of(behind, muxes_of(fingers)).items():
                transfers.append(enable_channels(mux, mask))
        transfers.append(Transfer(finger.address, bytes([RESULTS]), PACKET_BYTES))
    times = []
    for _ in range(TIMED_SCANS):
        started = time.perf_counter()
        bus.scan(transfers)
        times.append(time.perf_counter() - started)
    return sorted(times)[len(times) // 2]
