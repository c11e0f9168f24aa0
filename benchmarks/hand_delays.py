"""How long after a change of the field the hand acts: steps at all phases of a period.

Measured from the step to the answer that shows it in every finger: the chip's conversions at their
own times, the wait for the next sample, the read through the driver, and computing. The decision
acts at the model's act_samples-th risky sample. That the model calls the first changed sample risky
is assumed; how long it takes, docs/evaluation.md says.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np

from benchmarks.hand import CHECKED, RATES_HZ, Bench, ScanCost
from holdfast.core.contract import FloatArray
from holdfast.drivers.virtual.virtual_hand import REST_UT, Track

GRAVITY_M_S2 = 9.81
CLOSING_S = 0.37
"""Full stroke of the Michelangelo hand."""
STEPS = 64
PERIODS_APART = 6
GOLDEN = 0.5 * (5.0**0.5 - 1.0)
"""Multiples of it, without their whole part, are spread evenly over a period, however many there
are."""
STEP_UT = np.array([0.0, 0.0, 10e3])


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


def delays(
    scan_costs: list[ScanCost], compute_ms: float, act_samples: int, steps: int = STEPS
) -> list[ActDelay]:
    """One row per bridge and rate that it serves: ms from a step until the request to act."""
    default = [
        cost for cost in scan_costs if cost.layout == "mux" and cost.reads == CHECKED
    ]
    rates = [(cost, rate) for cost in default for rate in _served(cost)]
    return [
        _row(cost, rate_hz, compute_ms, act_samples, steps) for cost, rate_hz in rates
    ]


def _served(cost: ScanCost) -> Iterator[float]:
    return (rate for rate in RATES_HZ[:-1] if rate <= (cost.serves_model_hz or 0.0))


def _row(
    cost: ScanCost, rate_hz: float, compute_ms: float, act_samples: int, steps: int
) -> ActDelay:
    seen_ms = seen_after_ms(cost, rate_hz, steps) + compute_ms
    debounce_ms = 1e3 * (act_samples - 1) / rate_hz
    acted_ms = seen_ms + debounce_ms
    latest_s = 1e-3 * float(acted_ms.max())
    return ActDelay(
        bridge=cost.bridge,
        reads=cost.reads,
        bus_khz=cost.bus_khz,
        rate_hz=rate_hz,
        seen_ms=float(np.median(seen_ms)),
        debounce_ms=debounce_ms,
        acted_ms=float(np.median(acted_ms)),
        acted_p95_ms=float(np.percentile(acted_ms, 95.0)),
        acted_max_ms=1e3 * latest_s,
        falls_until_acted_mm=500.0 * GRAVITY_M_S2 * latest_s**2,
        falls_until_closed_mm=500.0 * GRAVITY_M_S2 * (latest_s + CLOSING_S) ** 2,
    )


def seen_after_ms(cost: ScanCost, rate_hz: float, steps: int = STEPS) -> FloatArray:
    """[steps] from a step of the field to the end of the first read with it in every finger."""
    bench = Bench(cost.bridge, cost.reads, bus_hz=1000 * cost.bus_khz)
    period_s = 1.0 / rate_hz
    start_s = 1e-9 * bench.clock.now_ns() + period_s
    steps_s = start_s + period_s * (
        PERIODS_APART * np.arange(1, steps + 1) + np.arange(steps) * GOLDEN % 1.0
    )
    bench.virtual.track = _staircase(steps_s)
    seen_s = np.full(steps, np.nan)
    for step, ended_s in _readings(bench, start_s, period_s, float(steps_s[-1])):
        up_to = np.searchsorted(steps_s, ended_s)
        if up_to and step == up_to % 2 and np.isnan(seen_s[up_to - 1]):
            seen_s[up_to - 1] = ended_s
    after_ms: FloatArray = 1e3 * (seen_s - steps_s)
    return after_ms


def _staircase(steps_s: FloatArray) -> Track:
    """Up at the first step, down at the second, and so on: within a nanosecond."""
    times_s = np.column_stack([steps_s, steps_s + 1e-9]).ravel()
    up = np.array([(k + side) % 2 for k in range(len(steps_s)) for side in (0, 1)])
    field_ut = REST_UT + up[:, None] * STEP_UT
    return Track(times_s, np.repeat(field_ut[:, None, :], 6, axis=1))


def _readings(
    bench: Bench, start_s: float, period_s: float, last_s: float
) -> Iterator[tuple[int | None, float]]:
    """(0 or 1: every finger reads the field down or up, None where they differ; when the read
    ended, s)."""
    turn = 0
    while start_s + turn * period_s < last_s + PERIODS_APART * period_s:
        bench.clock.wait_until(round(1e9 * (start_s + turn * period_s)))
        reading = bench.hand.read()
        ended_s = 1e-9 * bench.clock.now_ns()
        up = reading.field_ut[:, 2] > REST_UT[2] + 0.5 * STEP_UT[2]
        yield (int(up[0]) if up.all() or not up.any() else None), ended_s
        turn = max(turn + 1, int((ended_s - start_s) / period_s))
