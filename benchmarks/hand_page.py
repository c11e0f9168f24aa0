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

The default model at 150 Hz; each fault begins at 3 s and is scripted ([faults](../drivers/virtual/faults.py)). Times in
ms: detected and unknown after the fault's begin, whole and settled again after its end (settled: the model has
0.5 s of whole history again, which gaps up to 20 ms do not cost). "lost": samples whose time went by unread.

"""
DELAYS = """## From a change of the field to a closed hand

Means, ms, for reads with a CRC: the chip's mean over its conversion and the wait for its end, half a period, the bus,
computing, one more sample until the decision acts. Then the hand closes (0.37 s for the Michelangelo's full stroke),
and an object in free fall falls meanwhile: a hand that must close all the way is too late, one that holds it need not.

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
        {**row, "serves_model_hz": _rate(row["serves_model_hz"]), "crc_costs_us": _cost(row["crc_costs_us"])}
        for row in figures["scans"]
    ]
    live = [_stage(run, stage, times) for run in figures["live"] for stage, times in run["latency_us"].items()]
    live += [_stage(run, "floor of read to emit", run["floor_us"]) for run in figures["live"]]
    told = "; ".join(
        f"{run['rate_hz']:g} Hz: {run['samples']} samples, {run['overruns']} overruns, {run['share_of_period']:.0%} of "
        "the period"
        for run in figures["live"]
    )
    parts = [
        INTRO, SCANS + markdown(scans), FAULTS + markdown(figures["faults"]), DELAYS + markdown(figures["delays"]),
        LIVE + f"{told}.\n\n" + markdown(live), MEMORY + markdown(figures["memory"]),
    ]  # fmt: skip
    return "\n\n".join(parts) + "\n"


def _rate(rate_hz: float | None) -> str:
    return "none" if rate_hz is None else f"{rate_hz:g} Hz"


def _cost(cost_us: float | None) -> str:
    return "" if cost_us is None else f"{cost_us:.0f}"


def _stage(run: dict[str, Any], stage: str, times: dict[str, float]) -> dict[str, Any]:
    return {"rate_hz": run["rate_hz"], "stage": stage, **{name: f"{value:,.0f}" for name, value in times.items()}}


if __name__ == "__main__":
    sys.stdout.write(page(json.loads(Path(sys.argv[1]).read_text("utf-8"))))
