"""docs/hand.md, written from what `holdfast bench hand` measured: `make docs`."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from evaluation.page import markdown

INTRO = """# Reading six fingertips

How to wire them: [wiring](wiring.md). Written by `make docs` from `holdfast bench hand`. No silicon was measured:
transfers are the **emulation's** (bits at the bus's speed, USB round trips as their class has them), computing is a
machine's, whose own jitter stands beside it.

```sh
holdfast scan                                            # what is plugged in, and what is wrong with it
holdfast run MODEL --source usb://ft232h --view
holdfast run MODEL --source "virtual://ft232h?scene=pull-soft-ball&fault=nack:3@2%2B0.3"
```
"""
SCANS = """## What a scan costs

Six sensors on two channels of a mux (or one each, mux6); counted on the virtual bus. The chip itself converts at
412 Hz with 32 averages. "serves": the fastest usual model whose period is filled to 80 % at most.

"1-byte + CRC" is what the drivers ask for (`crc=auto`). The other reads are `crc=off` and `crc=off&burst=1`.
`crc_costs_us` is what the CRC adds to the same scan without one: nine bits a sensor. After a CRC that does not fit or a
missing acknowledge, each select of the mux is also read back for ten seconds, 50 us each on an FT232H at 400 kHz.

"""
FAULTS = """## When something fails

The default model at 150 Hz; each fault is scripted ([faults](../drivers/virtual/faults.py)). All times are in ms and
end when an answer is out: after its read and after computing. "detected" and "detected_max": from the fault's begin
until the answer is `unknown`, median and longest over 16 moments of a period at which the fault begins. "whole_again"
and "settled_again": from the fault's end until the last answer without a whole sample, and until the last `unknown`
(the model needs 0.5 s of whole history again after a gap of more than 20 ms); negative where that was before the
fault's end. "lost": samples whose time went by unread.

"""
DELAYS = """## From a change of the field to a closed hand

Steps of the field at 64 moments of a period, through each driver, read with a CRC. "seen": median ms from the step
until the answer to the first sample that shows it in every finger; it holds the chip's conversion, the wait for the
next sample, the read and computing. "acted": until the answer asks the hand to act, median, 95th percentile and
longest. The shipped model's card has act_samples = {act_samples}; every risky sample after the first costs a
period more. "falls": how far an object in free fall falls in the longest of these times. That the model calls the
first changed sample risky is assumed ([how long it takes](evaluation.md)). Then the hand closes: with the 0.37 s of the
Michelangelo's full stroke the object has fallen {closed}. A hand that has the whole way to close is too
late; one that already holds is not.

"""
LIVE = """## Where a sample's time goes

`run_live` for a minute, with real-time priority, on the virtual FT232H whose transfers take no time; "read" is mostly
the emulated engine's own computing. us; the floor is a busy wait of the same length, timed on the same machine.

"""
MEMORY = """## Memory and start

Resident memory of a process, MB, and seconds from its start until it has answered one sample of the default model; the
floor is Python with numpy and onnxruntime imported and nothing else.

"""


def page(figures: dict[str, Any]) -> str:
    """The whole page."""
    scans = [
        {
            **row,
            "serves_model_hz": _rate(row["serves_model_hz"]),
            "crc_costs_us": _cost(row["crc_costs_us"]),
        }
        for row in figures["scans"]
    ]
    live = [
        _stage(run, stage, times)
        for run in figures["live"]
        for stage, times in run["latency_us"].items()
    ]
    live += [_stage(run, "floor of read to emit", run["floor_us"]) for run in figures["live"]]
    told = "; ".join(
        f"{run['rate_hz']:g} Hz: {run['samples']} samples, {run['overruns']} overruns, {run['share_of_period']:.0%} of "
        "the period"
        for run in figures["live"]
    )
    parts = [
        INTRO,
        SCANS + markdown(scans),
        FAULTS + markdown(figures["faults"]),
        _delays(figures),
        LIVE + f"{told}.\n\n" + markdown(live),
        MEMORY + markdown(figures["memory"]),
    ]
    return "\n\n".join(parts) + "\n"


def _delays(figures: dict[str, Any]) -> str:
    """The text with the card's own number, and a row a bridge and rate."""
    rows = figures["delays"]
    closed_mm = [row["falls_until_closed_mm"] for row in rows]
    closed = f"{min(closed_mm):.0f} to {max(closed_mm):.0f} mm"
    return DELAYS.format(act_samples=figures["act_samples"], closed=closed) + markdown(
        [_delay(row) for row in rows]
    )


def _delay(row: dict[str, Any]) -> dict[str, Any]:
    shown = ("rate_hz", "seen_ms", "acted_ms", "acted_p95_ms", "acted_max_ms")
    return {
        "bridge": f"{row['bridge']}, {row['reads']}, {row['bus_khz']} kHz",
        **{name: row[name] for name in shown},
        "falls_mm": row["falls_until_acted_mm"],
    }


def _rate(rate_hz: float | None) -> str:
    return "none" if rate_hz is None else f"{rate_hz:g} Hz"


def _cost(cost_us: float | None) -> str:
    return "" if cost_us is None else f"{cost_us:.0f}"


def _stage(run: dict[str, Any], stage: str, times: dict[str, float]) -> dict[str, Any]:
    return {
        "rate_hz": run["rate_hz"],
        "stage": stage,
        **{name: f"{value:,.0f}" for name, value in times.items()},
    }


if __name__ == "__main__":
    sys.stdout.write(page(json.loads(Path(sys.argv[1]).read_text("utf-8"))))
