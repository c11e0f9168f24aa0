"""What reading six fingertips costs, and how it fails: the real drivers on the virtual hand.

Times of transfers are the emulation's (wire bits at the bus's speed, a USB round trip as its class
has it), not measured on silicon; times of computing are this machine's.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from holdfast.core.contract import Prediction, Sample
from holdfast.core.source import SourceReading
from holdfast.drivers.bridges import BRIDGES, open_virtual
from holdfast.drivers.bus import Bus, Reply, Transfer
from holdfast.drivers.hand import Hand, LiveHand
from holdfast.drivers.layout import read_layout
from holdfast.drivers.virtual.faults import VirtualClock, read_fault
from holdfast.drivers.virtual.usb_backend import Traffic
from holdfast.drivers.virtual.virtual_hand import VirtualHand
from holdfast.edge_runtime.model import Model
from holdfast.live.bench import step_of, time_in_turns
from holdfast.live.run import answer

FAULTS = {
    "nack:3@3+0.3": "finger 3 does not acknowledge for 0.3 s",
    "frozen:2@3+0.3": "finger 2 stops converting for 0.3 s",
    "por:4@3": "finger 4 loses its power for an instant",
    "sleep:5@3": "finger 5 is in sleep mode",
    "diag:6@3+0.3": "finger 6 fails its own diagnosis for 0.3 s",
    "stuck@3": "SDA is held low",
    "stall@3+0.1": "the bridge stalls for 0.1 s",
    "late@3+0.1": "the bridge answers too late for 0.1 s",
    "short@3+0.1": "the bridge answers partially for 0.1 s",
    "unplug@3+0.5": "the bridge is unplugged for 0.5 s",
}
FAULT_AT_S = 3.0
FAULT_RUN_S = 6.0
PHASES = 16
PHASES_FROM_S = 1.0
"""When a fault begins within a period, and where that period is: the model has settled by then."""
SCANS = 50
RATES_HZ = (300.0, 150.0, 100.0, 50.0)
SPARE = 0.8
NATIVE = "i2c"
"""The board's own bus, by smbus2; its transfers are ioctls."""


LOST = ("unknown", "degraded")
"""Answers of a hand that misses a sensor."""


@dataclass(frozen=True)
class ScanCost:
    """One scan of six fingers by bridge.

    serves_model_hz: the fastest model that it leaves time for, None: none.
    """

    bridge: str
    layout: str
    bus_khz: int
    transfers: float
    scan_ms: float
    scans_hz: float
    serves_model_hz: float | None


@dataclass(frozen=True)
class FaultRow:
    """What a fault does: its message, its detection, the recovery.

    detected_ms, detected_max_ms: median and longest over the phases of a period. settled_again_ms:
    after the fault's end. ends: the last state of the run.
    """

    fault: str
    what: str
    message: str
    detected_ms: float
    detected_max_ms: float
    settled_again_ms: float
    samples_lost: int
    ends: str


@dataclass
class Bench:
    """A virtual hand behind a bridge, its driver started."""

    bridge: str = "ft232h"
    layout: str = "mux"
    bus_hz: int = 400_000
    faults: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        self.clock = VirtualClock()
        self.virtual = VirtualHand(
            self.clock,
            layout=self.layout,
            seed=0,
            faults=[read_fault(one) for one in self.faults],
        )
        self.messages: list[str] = []
        opened: Callable[[], Bus]
        if self.bridge == NATIVE:
            self.traffic, opened = _native(self.virtual)
        else:
            bridge = open_virtual(self.bridge, self.virtual, self.bus_hz)
            self.traffic = bridge.backend.traffic
            opened = bridge
        self.hand = Hand(
            opened,
            read_layout(self.layout),
            now_ns=self.clock.now_ns,
            pause=lambda seconds: self.clock.spend(round(1e9 * seconds)),
            say=self.messages.append,
        )
        self.hand.start()

    def source(self) -> LiveHand:
        """Its samples, in about the newtons of the scenes' sensors."""
        return LiveHand(self.hand, lambda field_ut: 1e-3 * field_ut)


def _native(virtual: VirtualHand) -> tuple[Traffic, Callable[[], Bus]]:
    """The board's own bus before a virtual hand, for as long as this process lives."""
    from holdfast.drivers.native_i2c import NativeI2C
    from holdfast.drivers.virtual.native import VirtualI2cDev

    device = VirtualI2cDev(virtual)

    class Own(NativeI2C):
        """Whose every call finds the virtual bus, and leaves smbus2 as it was."""

        def __init__(self) -> None:
            with device:
                super().__init__(1)

        def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
            with device:
                return super().scan(transfers)

    return device.traffic, Own


def scan_costs() -> list[ScanCost]:
    """One row for each bridge, clock and layout."""
    ways = [(bridge, "mux", 400_000) for bridge in (*BRIDGES, NATIVE)]
    ways += [("ft232h", "mux", 1_000_000)]
    ways += [("ft232h", "mux6", 400_000)]
    return [_scan_cost(*way) for way in ways]


def _scan_cost(bridge: str, layout: str, bus_hz: int) -> ScanCost:
    bench = Bench(bridge, layout, bus_hz)
    traffic = bench.traffic
    before_ns = bench.clock.now_ns()
    traffic.transfers = 0
    for _ in range(SCANS):
        bench.hand.read()
    scan_s = 1e-9 * (bench.clock.now_ns() - before_ns) / SCANS
    return ScanCost(
        bridge=bridge,
        layout=layout,
        bus_khz=bus_hz // 1000,
        transfers=traffic.transfers / SCANS,
        scan_ms=1e3 * scan_s,
        scans_hz=1.0 / scan_s,
        serves_model_hz=next(
            (rate for rate in RATES_HZ if scan_s * rate < SPARE), None
        ),
    )


def fault_table(model_path: Path, phases: int = PHASES) -> list[FaultRow]:
    """One row per fault at the model's rate.

    phases: detection is measured for faults that begin at so many moments of a period, everything
    else once.
    """
    model = Model(model_path)
    # No virtual clock knows how long the step computes.
    step_us = time_in_turns({"step": step_of(model)})["step"]
    compute_ms = 1e-3 * float(np.median(step_us))
    return [_fault_row(model, fault, compute_ms, phases) for fault in FAULTS]


def _fault_row(model: Model, fault: str, compute_ms: float, phases: int) -> FaultRow:
    bench = Bench(faults=(fault,))
    rows: list[tuple[float, str]] = []

    def emit(prediction: Prediction, sample: Sample, measured: SourceReading) -> None:
        answered_s = 1e-9 * bench.clock.now_ns() + 1e-3 * compute_ms
        rows.append((answered_s, _answer(prediction)))

    end_ns = round(1e9 * FAULT_RUN_S)
    summary = answer(
        bench.source(), model, bench.clock, emit, lambda: bench.clock.now_ns() >= end_ns
    )
    last_lost_s = max(t for t, state in rows if t >= FAULT_AT_S and state in LOST)
    ends_s = FAULT_AT_S + (read_fault(fault).lasts_s if "+" in fault else 0.0)
    detected_ms = []
    for phase in range(phases):
        found_ms = _detected_ms(model, fault, phase / phases)
        detected_ms.append(found_ms + compute_ms)
    return FaultRow(
        fault=fault,
        what=FAULTS[fault],
        message=bench.messages[0].split(";")[0] if bench.messages else "",
        detected_ms=float(np.median(detected_ms)),
        detected_max_ms=max(detected_ms),
        settled_again_ms=1e3 * (last_lost_s - ends_s),
        samples_lost=summary.overruns,
        ends=rows[-1][1],
    )


def _answer(prediction: Prediction) -> str:
    """The state, or "degraded" where some sensors are missing and enough are left."""
    return "degraded" if prediction.degraded else prediction.state


def _detected_ms(model: Model, fault: str, phase: float) -> float:
    """From a fault at this phase of a period, 0 .. 1, until an answer of LOST is out."""
    at_s = PHASES_FROM_S + phase / model.card.rate_hz
    bench = Bench(faults=(fault.replace(f"@{FAULT_AT_S:g}", f"@{at_s:.6f}"),))
    found_s: list[float] = []

    def emit(prediction: Prediction, sample: Sample, measured: SourceReading) -> None:
        now_s = 1e-9 * bench.clock.now_ns()
        if now_s >= at_s and _answer(prediction) in LOST:
            found_s.append(now_s)

    end_ns = round(1e9 * (at_s + 1.0))

    def stopped() -> bool:
        return bool(found_s) or bench.clock.now_ns() >= end_ns

    answer(bench.source(), model, bench.clock, emit, stopped)
    return 1e3 * (found_s[0] - at_s) if found_s else float("inf")
