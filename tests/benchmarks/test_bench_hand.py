"""`holdfast bench hand`: scans counted, faults all green, delays added up, and the page made from them."""

from __future__ import annotations

from pathlib import Path

import pytest

from benchmarks.hand import FAULTS, RATES_HZ, delays, fault_table, latency, memory, scan_costs
from benchmarks.hand_page import page
from drivers.bridges import BRIDGES
from edge_runtime.live import STAGES

ROOT = Path(__file__).resolve().parents[2]
MODEL = ROOT / "models" / "holdfast-150hz.onnx"


@pytest.fixture(scope="module")
def scans():
    return scan_costs()


def test_six_sensors_over_an_ft232h_are_two_transfers_and_four_hundred_scans_a_second(scans):
    best = [row for row in scans if row["bridge"] == "ft232h"]
    assert all(row["transfers"] == 2 for row in best)
    assert min(row["scans_hz"] for row in best) >= 400.0


def test_every_bridge_has_its_row_and_only_serves_rates_that_leave_it_time(scans):
    assert {row["bridge"] for row in scans} == {*BRIDGES, "i2c"}
    for row in scans:
        served = row["serves_model_hz"]
        assert served is None or (served in RATES_HZ and served * row["scan_ms"] < 800.0)


def test_every_fault_is_unknown_within_two_samples_or_the_stale_time_and_ends_whole():
    for row in fault_table(MODEL):
        limit_ms = 20.0 + 2e3 / 150 if "frozen" in row["fault"] or "sleep" in row["fault"] else 2e3 / 150
        assert row["first_unknown_ms"] <= limit_ms, row
        assert row["said"], row
        assert row["settled_again_ms"] < 700.0, row
        assert row["ends"] == "nothing", row
    assert len(FAULTS) == 10


def test_a_delay_is_the_sum_of_its_parts(scans):
    for row in delays(scans, 0.5):
        parts = sum(row[name] for name in ("conversion_ms", "waits_ms", "bus_ms", "compute_ms", "debounce_ms"))
        assert row["asked_ms"] == pytest.approx(parts)
        assert row["falls_until_asked_mm"] == pytest.approx(0.5 * 9.81 * (1e-3 * parts) ** 2 * 1e3)


def test_the_live_loop_has_a_time_for_every_stage_and_the_page_shows_it(scans):
    live = latency(MODEL, 150.0, 1.0)
    assert list(live["latency_us"]) == [*STAGES, "read to emit"]
    assert live["samples"] > 100
    text = page({"scans": scans, "faults": fault_table(MODEL)[:1], "live": [live], "delays": delays(scans, 0.5),
                 "memory": memory(MODEL)})  # fmt: skip
    assert "| ft232h | registers |" in text
    assert "floor of read to emit" in text
    assert "finger 3: nack" in text
