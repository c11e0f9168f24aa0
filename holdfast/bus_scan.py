"""One bus: which sensors and muxes are on it, and how fast they can be read."""

from __future__ import annotations

import time
from collections.abc import Sequence
from typing import Any

from holdfast.drivers.bus import Bus, Transfer
from holdfast.drivers.layout import masks_of, muxes_of, read_layout
from holdfast.drivers.mux import enable_channels
from holdfast.drivers.scanning import as_layout, look_at
from holdfast.drivers.tmag5273 import PACKET_BYTES, RESULTS
from holdfast.edge_runtime.command import show
from holdfast.live_sources import named_addresses, open_bus
from holdfast.real_time import RunClock

TIMED_SCANS = 20
MODEL_RATES_HZ = (300.0, 150.0, 100.0, 50.0)
SPARE = 0.8
"""Largest share of a period that a scan may take: the rest is for the model and for delays."""


def scan(url: str) -> None:
    """Print what is on one bus. Raises a DeviceError."""
    clock = RunClock()
    bus = open_bus(url, clock)
    try:
        show(url)
        devices = look_at(bus, lambda s: clock.spend(round(1e9 * s)), named_addresses(url))
        _show_devices(devices)
        if layout := as_layout(devices):
            n_sensors = len(layout.split(","))
            print(f"  {n_sensors} sensors: layout={layout} (put them in the order of the fingers)")
            print(f"  {rate_line(bus, layout)}")
        else:
            print("  no sensor: power, SDA and SCL swapped, or pull-ups missing?")
    finally:
        bus.close()


def _show_devices(devices: Sequence[Any]) -> None:
    """A line for each device: mux and channel, address, what it is, what is wrong with it."""
    several = sum(one.kind == "mux" for one in devices) > 1
    for one in devices:
        behind = "" if one.channel is None else f"channel {one.channel}, "
        mux = f"mux {one.mux:#04x}, " if behind and several else ""
        place = f"{mux}{behind}{one.address:#04x}"
        show(f"  {place:<{30 if several else 18}}{one.what:<28}{one.trouble}".rstrip())


def rate_line(bus: Bus, layout: str) -> str:
    """The time of one scan of these sensors, and the fastest model that it is enough for."""
    transfers, behind = [], frozenset[tuple[int, int]]()
    fingers = read_layout(layout)
    for finger in fingers:
        if finger.behind not in (frozenset(), behind):
            behind = finger.behind
            transfers += [
                enable_channels(mux, mask)
                for mux, mask in masks_of(behind, muxes_of(fingers)).items()
            ]
        transfers.append(Transfer(finger.address, bytes([RESULTS]), PACKET_BYTES))
    times = []
    for _ in range(TIMED_SCANS):
        started = time.perf_counter()
        bus.scan(transfers)
        times.append(time.perf_counter() - started)
    scan_s = sorted(times)[len(times) // 2]
    served = next((rate for rate in MODEL_RATES_HZ if scan_s * rate < SPARE), None)
    scan = f"a scan takes {1e3 * scan_s:.2f} ms ({1.0 / scan_s:.0f} Hz)"
    if served is None:
        return f"{scan}: serves no model, {MODEL_RATES_HZ[-1]:g} Hz needs another bridge"
    return f"{scan}: serves a model of {served:g} Hz"
