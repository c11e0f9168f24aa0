"""What reading six fingertips costs, and how it fails: the real drivers on the virtual hand.

Times of transfers are the emulation's (wire bits at the bus's speed, a USB round trip as its class
has it), not measured on silicon; times of computing are this machine's.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from holdfast.core.contract import Prediction
from holdfast.drivers.bridges import open_virtual
from holdfast.drivers.bus import BRIDGE, Reply, Transfer
from holdfast.drivers.chips import DEFAULT_CHIP, driver_of
from holdfast.drivers.hand import Hand
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
"""The board's own bus; its transfers are ioctls."""
OWN_HZ, IOCTL_NS = 400_000, 50_000
"""Interrupts, context switches and the controller's set-up take that long."""


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
    serves_model_hz: float | None


@dataclass(frozen=True)
class FaultRow:
    """What a fault does: its detection, the recovery.

    detected_ms, detected_max_ms: median and longest over the phases of a period. settled_again_ms:
    after the fault's end. ends: the last state of the run.
    """

    fault: str
    what: str
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
        places = read_layout(self.layout, driver_of(DEFAULT_CHIP).addresses)
        self.virtual = VirtualHand(
            self.clock,
            places=places,
            seed=0,
            faults=[read_fault(one) for one in self.faults],
        )
        bridge: Any = open_virtual(self.virtual, self.bus_hz)
        self.traffic: Traffic = bridge.args[0].traffic
        if self.bridge == NATIVE:
            bridge = partial(OwnBus, self.virtual, self.traffic)
        self.hand = Hand(
            bridge,
            places,
            now_ns=self.clock.now_ns,
            pause=lambda seconds: self.clock.spend(round(1e9 * seconds)),
            # any newtons will do: about those of the scenes' sensors
            to_force=lambda field_ut: 1e-3 * field_ut,
        )
        self.hand.start()


class OwnBus:
    """The board's own bus before a virtual hand: an ioctl for each transfer, then its bits."""

    def __init__(self, hand: VirtualHand, traffic: Traffic) -> None:
        self._hand = hand
        self._traffic = traffic

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """A reply for each; every chip is there."""
        bits = self._hand.wire.bits
        replies = [Reply(self._carry(transfer), acked=True) for transfer in transfers]
        self._traffic.transfers += len(replies)
        wire_ns = round(1e9 * (self._hand.wire.bits - bits) / OWN_HZ)
        self._hand.clock.spend(IOCTL_NS * len(replies) + wire_ns)
        return replies

    def _carry(self, transfer: Transfer) -> bytes:
        wire = self._hand.wire
        if transfer.write:
            wire.start()
            for byte in (transfer.address << 1, *transfer.write):
                wire.write(byte)
        if transfer.read:
            wire.start()
            wire.write(transfer.address << 1 | 1)
        data = bytes(wire.read() for _ in range(transfer.read))
        wire.stop()
        return data


def scan_costs() -> list[ScanCost]:
    """One row for each bridge, clock and layout."""
    ways = [(bridge, "mux", 400_000) for bridge in (BRIDGE, NATIVE)]
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

    def emit(prediction: Prediction, *sample: object) -> None:
        answered_s = 1e-9 * bench.clock.now_ns() + 1e-3 * compute_ms
        rows.append((answered_s, _answer(prediction)))

    end_ns = round(1e9 * FAULT_RUN_S)
    summary = answer(
        bench.hand, model, bench.clock, emit, lambda: bench.clock.now_ns() >= end_ns
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

    def emit(prediction: Prediction, *sample: object) -> None:
        now_s = 1e-9 * bench.clock.now_ns()
        if now_s >= at_s and _answer(prediction) in LOST:
            found_s.append(now_s)

    end_ns = round(1e9 * (at_s + 1.0))

    def stopped() -> bool:
        return bool(found_s) or bench.clock.now_ns() >= end_ns

    answer(bench.hand, model, bench.clock, emit, stopped)
    return 1e3 * (found_s[0] - at_s) if found_s else float("inf")
