"""Rows of `make bench NAME=hand`; `asdict` or `to_json` gives their part of hand.json."""

from __future__ import annotations

from dataclasses import asdict, dataclass

from holdfast.core.reading import Json
from holdfast.evaluation.latency.memory import ProcessMemory

Percentiles = dict[str, float]
"""p50, p99 and p99.9 -> us."""


@dataclass(frozen=True)
class ScanCost:
    """One scan of six fingers, by bridge and way to read.

    serves_model_hz: the fastest model that it leaves time for, None: none. crc_costs_us: what the
    CRC adds, None where there is nothing to compare with.
    """

    bridge: str
    reads: str
    layout: str
    bus_khz: int
    transfers: float
    bytes_out: float
    bytes_in: float
    scan_ms: float
    scans_hz: float
    serves_model_hz: float | None
    crc_costs_us: float | None = None


@dataclass(frozen=True)
class FaultRow:
    """What a fault does: its message, its detection, the states meanwhile, the recovery.

    detected_ms, detected_max_ms: median and longest over the phases of a period. whole_again_ms,
    settled_again_ms: after the fault's end. ends: the last state of the run.
    """

    fault: str
    what: str
    message: str
    detected_ms: float
    detected_max_ms: float
    meanwhile: str
    whole_again_ms: float
    settled_again_ms: float
    samples_lost: int
    ends: str

    def to_json(self) -> Json:
        """As it stands in hand.json, where the message's key is "said"."""
        return {
            "said" if key == "message" else key: value
            for key, value in vars(self).items()
        }


@dataclass(frozen=True)
class LiveLatency:
    """A run of the live loop in real time. latency_us: by stage. floor_us: the busy wait's."""

    rate_hz: float
    samples: int
    overruns: int
    latency_us: dict[str, Percentiles]
    share_of_period: float
    floor_us: Percentiles


@dataclass(frozen=True)
class ActDelay:
    """From a step of the field to the request to act, with a bridge at a rate.

    seen_ms: until all fingers show it. falls_until_acted_mm, falls_until_closed_mm: how far an
    object falls in the longest of these times, and until a hand has closed.
    """

    bridge: str
    reads: str
    bus_khz: int
    rate_hz: float
    seen_ms: float
    debounce_ms: float
    acted_ms: float
    acted_p95_ms: float
    acted_max_ms: float
    falls_until_acted_mm: float
    falls_until_closed_mm: float


@dataclass(frozen=True)
class HandFigures:
    """Everything that hand.json holds of the hand. act_samples: of the model's card."""

    scans: list[ScanCost]
    faults: list[FaultRow]
    live: list[LiveLatency]
    act_samples: int
    delays: list[ActDelay]
    memory: list[ProcessMemory]

    def to_json(self) -> Json:
        """As it stands in hand.json."""
        return asdict(self) | {"faults": [row.to_json() for row in self.faults]}
