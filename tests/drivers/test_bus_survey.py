"""What a survey of a bus says: its rate, the model that this serves, and where each chip is."""

from __future__ import annotations

import pytest

from holdfast.drivers.bus_survey import ScannedBus


@pytest.mark.parametrize(
    ("scan_s", "model_hz", "what"),
    [
        (0.002, 150.0, "a scan takes 2.00 ms (500 Hz): serves a model of 150 Hz"),
        (0.05, None, "a scan takes 50.00 ms (20 Hz): serves no model"),
    ],
)
def test_a_survey_says_how_long_a_scan_takes_and_which_model_that_serves(
    scan_s: float, model_hz: float | None, what: str
) -> None:
    lines = ScannedBus("i2c://1", [], "35,22,78", scan_s, model_hz).lines()
    assert lines[:1] == ["i2c://1"]
    assert lines[1].startswith("  3 sensors: layout=35,22,78 (")
    assert lines[2].startswith(f"  {what}")


def test_a_bus_without_a_sensor_has_likely_causes() -> None:
    (_, cause) = ScannedBus("i2c://1", []).lines()
    assert "SDA and SCL swapped" in cause
