"""Scans that an FT232H times itself, beside the scan of today, while the host stalls: virtual.

`python -m benchmarks.timed_scans OUT.json`. The real drivers on an emulated FT232H and a
virtual clock; the host's stalls are drawn at random, the same for every row of a mean.
"""

from __future__ import annotations

import json
import sys
from collections.abc import Sequence
from contextlib import AbstractContextManager
from dataclasses import asdict, dataclass
from pathlib import Path

import numpy as np

from holdfast.cli.command import show
from holdfast.core.contract import FloatArray
from holdfast.core.reading import Json
from holdfast.core.writing import write_whole
from holdfast.drivers.bridges import open_virtual
from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.ft232h_timed import TimedFt232h
from holdfast.drivers.hand import Hand
from holdfast.drivers.layout import read_layout
from holdfast.drivers.virtual.clock import VirtualClock
from holdfast.drivers.virtual.usb_devices import AtOnce
from holdfast.drivers.virtual.virtual_hand import VirtualHand
from holdfast.evaluation.provenance import host

RATE_HZ, SECONDS = 150.0, 120.0
STALL_EVERY, MEANS_MS = 150, (5.0, 20.0, 60.0)
"""One stall in so many samples, of exponential length."""
BLOCKS = (2, 4, 8)
"""Scans in a block; two are queued, and the chip keeps the answers of 17."""
SEED = 0


@dataclass(frozen=True)
class ScanRow:
    """What one way of scanning made of the stalls. stall_ms: their mean.

    queued: scans ahead at most, 0 for today's. spacing_us: 99.9 % of the errors of the time between
    two samples that follow each other. late: from when a sample was due until the host had it.
    """

    stall_ms: float
    queued: int
    samples: int
    lost: int
    spacing_p999_us: float
    late_p50_ms: float
    late_p999_ms: float
    late_max_ms: float


class DeviceTimes(VirtualClock):
    """Notes when the bridge did something by itself."""

    def __init__(self) -> None:
        super().__init__()
        self.began_ns: list[int] = []

    def at(self, t_ns: int) -> AbstractContextManager[None]:
        """As it is."""
        self.began_ns.append(t_ns)
        return super().at(t_ns)


class Kept(TimedFt232h):
    """Remembers the transfers of the last scan."""

    last: Sequence[Transfer] = ()

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        """As it is."""
        self.last = transfers
        return super().scan(transfers)


def started() -> tuple[Kept, DeviceTimes]:
    """A hand brought up by the driver, and its clock."""
    clock = DeviceTimes()
    bridge = open_virtual("ft232h", VirtualHand(clock, seed=SEED), 400_000)
    bus = Kept(bridge.backend, now_ns=clock.now_ns, writer=AtOnce())
    hand = Hand(
        lambda: bus,
        read_layout("mux"),
        crc="on",
        now_ns=clock.now_ns,
        pause=lambda seconds: clock.spend(round(1e9 * seconds)),
    )
    hand.start()
    hand.read()
    hand.read()
    return bus, clock


def stalls_ns(mean_ms: float, samples: int) -> list[int]:
    """[samples]: how long the host is away before each."""
    random = np.random.default_rng([SEED, round(10 * mean_ms)])
    lasts = random.exponential(1e6 * mean_ms, samples) * (
        random.random(samples) < 1 / STALL_EVERY
    )
    return [round(one) for one in lasts]


def today(away_ns: Sequence[int], mean_ms: float) -> ScanRow:
    """One scan a request, each due at its own time, as in the live loop; a late one is skipped."""
    bus, clock = started()
    period_ns, start_ns, turn = 1e9 / RATE_HZ, clock.now_ns(), 0
    numbers: list[int] = []
    began: list[int] = []
    late: list[int] = []
    while turn < len(away_ns):
        due_ns = start_ns + round(turn * period_ns)
        clock.wait_until(due_ns)
        clock.spend(away_ns[turn])
        numbers.append(turn)
        began.append(clock.now_ns())
        bus.scan(bus.last)
        late.append(clock.now_ns() - due_ns)
        turn = max(turn + 1, int((clock.now_ns() - start_ns) / period_ns))
    return _row(mean_ms, 0, numbers, began, late)


def timed(away_ns: Sequence[int], mean_ms: float, block: int) -> ScanRow:
    """Two blocks of scans queued ahead."""
    bus, clock = started()
    bus.begin(bus.last, round(1e9 / RATE_HZ), block)
    numbers: list[int] = []
    planned: list[int] = []
    late: list[int] = []
    while not numbers or numbers[-1] < len(away_ns) - 1:
        clock.spend(away_ns[numbers[-1] + 1 if numbers else 0])
        one = bus.next()
        numbers.append(one.number)
        planned.append(one.t_ns)
        late.append(clock.now_ns() - one.t_ns)
    return _row(mean_ms, 2 * block, numbers, _nearest(clock.began_ns, planned), late)


def _nearest(began_ns: Sequence[int], planned_ns: Sequence[int]) -> list[int]:
    """When each scan really began: the device's own time nearest to the driver's."""
    began = np.array(began_ns)
    after = np.clip(np.searchsorted(began, planned_ns), 1, len(began) - 1)
    first = np.abs(began[after - 1] - planned_ns) < np.abs(began[after] - planned_ns)
    return [int(one) for one in began[after - first]]


def _row(
    mean_ms: float, queued: int, numbers: list[int], began: list[int], late: list[int]
) -> ScanRow:
    follows = np.diff(numbers) == 1
    spacing_us = 1e-3 * np.abs(np.diff(began)[follows] - 1e9 / RATE_HZ)
    late_ms: FloatArray = 1e-6 * np.array(late, dtype=np.float64)
    return ScanRow(
        stall_ms=mean_ms,
        queued=queued,
        samples=len(numbers),
        lost=numbers[-1] + 1 - len(numbers),
        spacing_p999_us=float(np.percentile(spacing_us, 99.9)),
        late_p50_ms=float(np.median(late_ms)),
        late_p999_ms=float(np.percentile(late_ms, 99.9)),
        late_max_ms=float(late_ms.max()),
    )


def measure(seconds: float = SECONDS) -> Json:
    """All rows."""
    rows = []
    for mean_ms in MEANS_MS:
        away_ns = stalls_ns(mean_ms, round(seconds * RATE_HZ))
        rows += [
            today(away_ns, mean_ms),
            *(timed(away_ns, mean_ms, one) for one in BLOCKS),
        ]
    return {
        "kind": "simulated",
        "host": asdict(host()),
        "rate_hz": RATE_HZ,
        "seed": SEED,
        "rows": [asdict(row) for row in rows],
    }


if __name__ == "__main__":
    show(str(write_whole(Path(sys.argv[1]), json.dumps(measure(), indent=1) + "\n")))
