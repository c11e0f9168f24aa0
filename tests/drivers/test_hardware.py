"""A real hand: `HOLDFAST_HAND=usb://ft232h python -m pytest -m hardware`. Without one these are
never run."""

from __future__ import annotations

import os
import time

import numpy as np
import pytest

from holdfast.core.source import MonotonicClock
from holdfast.drivers.chips import driver_of
from holdfast.drivers.scan import look_at
from holdfast.live.running import RunClock
from holdfast.live.sources import open_bus, open_live

pytestmark = pytest.mark.hardware
URL = os.environ.get("HOLDFAST_HAND", "usb://ft232h")


def test_every_finger_is_found_and_well():
    bus = open_bus(URL, RunClock())
    found = look_at(bus, driver_of("tmag5273"), time.sleep)
    bus.close()
    sensors = [one for one in found if one.kind == "sensor"]
    assert len(sensors) == 6
    assert [one.trouble for one in sensors] == [""] * 6


def test_ten_seconds_at_150_hz_are_read_without_a_gap():
    clock = MonotonicClock()
    source = open_live(URL, clock=RunClock(), report=print)
    start_ns = clock.now_ns()
    invalid = 0
    late = 0
    for k in range(1500):
        clock.wait_until(start_ns + round(k * 1e9 / 150))
        late += clock.now_ns() > start_ns + round((k + 1) * 1e9 / 150)
        measured = source.read()
        assert measured is not None
        invalid += not measured.valid.all()
    source.close()
    assert (invalid, late) == (0, 0)


def test_a_resting_hand_has_the_noise_of_the_data_sheet():
    source = open_live(URL, clock=RunClock(), report=print)
    rows = []
    for _ in range(300):
        measured = source.read()
        assert measured is not None
        rows.append(measured.values)
        time.sleep(0.005)
    source.close()
    spread = np.std(np.array(rows).reshape(300, 6, 3), axis=0)
    assert spread.max() < 60.0
