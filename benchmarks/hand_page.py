"""The tables of docs/hand.md, from what `holdfast bench hand` measured: `make docs`."""

from __future__ import annotations

import sys
from pathlib import Path

from holdfast.core.reading import Json
from holdfast.evaluation.formats import markdown
from tools.doc_tables import Tables, refresh, table

SCAN_HEADS = {
    "bridge": "bridge",
    "reads": "reads",
    "layout": "layout",
    "bus_khz": "bus, kHz",
    "transfers": "transfers",
    "scan_ms": "scan, ms",
    "serves": "fastest model, Hz",
    "crc": "CRC, us",
}
FAULT_HEADS = {
    "fault": "fault",
    "what": "what happens",
    "said": "message",
    "detected_ms": "detected, ms",
    "detected_max_ms": "longest, ms",
    "whole_again_ms": "samples whole again, ms",
    "settled_again_ms": "settled again, ms",
    "samples_lost": "samples lost",
}
DELAY_HEADS = {
    "way": "bridge, reads, bus",
    "rate_hz": "rate, Hz",
    "seen_ms": "seen, ms",
    "acted_ms": "request, median, ms",
    "acted_p95_ms": "95 %, ms",
    "acted_max_ms": "longest, ms",
    "falls_until_acted_mm": "falls, mm",
}
RUN_HEADS = {
    "rate_hz": "rate, Hz",
    "samples": "samples",
    "overruns": "overruns",
    "share": "share of the period",
}
PROCESS = {"floor": "Python with numpy and onnxruntime"}


def tables(figures: Json) -> Tables:
    """Every table by its marker."""
    stages = [row for run in figures["live"] for row in _stages(run)]
    stages += [
        _stage(run, "busy-wait reference, same length", run["floor_us"])
        for run in figures["live"]
    ]
    runs = [run | {"share": f"{run['share_of_period']:.0%}"} for run in figures["live"]]
    return {
        "scans": table([_scan(row) for row in figures["scans"]], SCAN_HEADS),
        "faults": table(
            [row | {"fault": f"`{row['fault']}`"} for row in figures["faults"]],
            FAULT_HEADS,
        ),
        "delays-about": markdown(_about(figures)),
        "delays": table([_delay(row) for row in figures["delays"]], DELAY_HEADS),
        "live-runs": table(runs, RUN_HEADS),
        "live": markdown(stages),
        "memory": markdown([_process(row) for row in figures["memory"]]),
    }


def _scan(row: Json) -> Json:
    rate_hz, crc_us = row["serves_model_hz"], row["crc_costs_us"]
    return row | {
        "serves": "none" if rate_hz is None else f"{rate_hz:g}",
        "crc": None if crc_us is None else f"{crc_us:.0f}",
    }


def _about(figures: Json) -> list[Json]:
    """What the card says, and how far an object falls until a hand has closed."""
    closed_mm = [row["falls_until_closed_mm"] for row in figures["delays"]]
    return [
        {
            "what": "`act_samples` of the shipped model's card",
            "value": figures["act_samples"],
        },
        {
            "what": "fall until the hand has closed, smallest and largest of the rows below, mm",
            "value": f"{min(closed_mm):.0f} to {max(closed_mm):.0f}",
        },
    ]


def _delay(row: Json) -> Json:
    return row | {"way": f"{row['bridge']}, {row['reads']}, {row['bus_khz']} kHz"}


def _stages(run: Json) -> list[Json]:
    return [_stage(run, stage, times) for stage, times in run["latency_us"].items()]


def _stage(run: Json, stage: str, times_us: dict[str, float]) -> Json:
    return {
        "rate, Hz": run["rate_hz"],
        "stage": stage,
        **{f"{name}, us": f"{value:,.0f}" for name, value in times_us.items()},
    }


def _process(row: Json) -> Json:
    return {
        "process": PROCESS.get(row["process"], row["process"]),
        "resident memory, MB": row["resident_mb"],
        "start, s": row["start_s"],
    }


if __name__ == "__main__":
    refresh(sys.argv[2], {Path(sys.argv[1]): tables})
