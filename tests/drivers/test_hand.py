"""The hand behind a bridge: what it reads, what it says when something fails, and how it comes
back."""

from __future__ import annotations

import gc
import os
import sys
from collections.abc import Callable

import numpy as np
import pytest
from hand_bench import PERIOD_NS, Bench, bad, started
from hazard_marks import CORRUPT_READING

from holdfast.core.errors import DeviceNotFound, UsageError, WrongDevice
from holdfast.drivers.bus import Transfer
from holdfast.drivers.chips import STALE_NS
from holdfast.drivers.layout import LAYOUTS, MUX_ADDRESSES, ScanPlanner, read_layout
from holdfast.drivers.tmag5273.registers import FACTORY_ADDRESSES
from holdfast.drivers.virtual.faults import VirtualClock
from holdfast.drivers.virtual.virtual_hand import Track


class Faltering(VirtualClock):
    """A machine that stands still for once, at the next transfer."""

    lost_ns = 0

    def spend(self, duration_ns: int) -> None:
        super().spend(duration_ns + self.lost_ns)
        self.lost_ns = 0


@pytest.mark.parametrize("layout", LAYOUTS)
def test_six_fingers_report_the_field_at_their_magnets(layout):
    field_ut = np.arange(18.0).reshape(1, 6, 3) * 500.0
    bench = started(
        track=Track(np.array([0.0]), field_ut),
        layout=layout,
    )
    reading = bench.read_for(0.05)[-1]
    assert reading.valid.all()
    assert reading.why == ("",) * 6
    np.testing.assert_allclose(reading.values, field_ut[0].reshape(-1), atol=110.0)


def test_a_start_waits_until_the_first_reading_is_whole():
    assert started().hand.read().why == ("",) * 6


def test_a_finger_that_is_not_acknowledged_costs_only_itself_and_comes_back():
    bench = started("nack:3@1+0.3")
    readings = bench.read_for(2.0)
    assert bad(readings) == bad(readings, finger=3)
    times = [r.t_ns * 1e-9 for r in bad(readings)]
    assert 1.0 <= times[0] < 1.0 + 2 / 150
    assert times[-1] < 1.3 + 0.05 + 3 / 150
    assert bench.messages[0] == "finger 3: nack"
    assert bench.messages[-1] == "finger 3: good again"


@pytest.mark.hard_case(
    "Time and schedule",
    "a sensor that stands still",
    elsewhere="equal readings are taken for a quiet hand",
    here="the chip's own counter says whether it has converted; stale within 20 ms and one sample",
)
def test_a_chip_that_converts_no_more_is_stale_within_twenty_milliseconds_and_one_sample():
    bench = started("frozen:2@1+0.3")
    found = bad(bench.read_for(2.0), finger=2)
    assert found[0].why[1] == "stale"
    assert found[0].t_ns - 1e9 <= STALE_NS + 2 * PERIOD_NS
    assert found[-1].t_ns < 1.3e9 + 100e6
    gaps = np.diff([r.t_ns for r in found])
    assert gaps.max() < 1.5 * PERIOD_NS  # never good in between


def test_a_slow_reader_takes_no_roll_over_of_the_counter_for_a_stop_and_still_sees_one():
    readings = started("frozen:2@4+1").read_for(6.0, rate_hz=50.0)
    found = bad(readings)
    assert found == bad(readings, finger=2)
    assert 4e9 < found[0].t_ns < 4e9 + STALE_NS + 2 * 20e6
    assert found[-1].t_ns < 5.1e9


@pytest.mark.parametrize(
    ("fault", "why"),
    [("por:4@1", "reset"), ("sleep:4@1", "nack"), ("diag:4@1+0.1", "diagnosis")],
)
def test_a_chip_that_lost_itself_is_brought_up_while_the_others_are_read(fault, why):
    readings = started(fault).read_for(2.0)
    found = bad(readings)
    assert found == bad(readings, finger=4)
    assert found[0].why[3] == why
    assert found[0].t_ns < 1e9 + 2 * PERIOD_NS
    assert found[-1].t_ns < 1.1e9 + 0.1e9


@pytest.mark.parametrize("at_s", [0.999, 1.0, 1.002, 1.004, 2.05])
def test_a_chip_that_slept_gives_no_erased_result_as_a_reading(at_s):
    for reading in started(f"sleep:5@{at_s}").read_for(2.0):
        field_ut = reading.values.reshape(-1, 3)
        assert (np.abs(field_ut[reading.valid]).max(axis=1) > 0.0).all()


@pytest.mark.hard_case(
    "What comes from outside",
    "a bridge that stalls, falls short, is late or is pulled out",
    elsewhere="the last values stay, and look like a hand at rest",
    here="every finger is invalid at once, the bridge is brought back",
)
@pytest.mark.parametrize(
    "fault", ["stuck@1", "stall@1+0.05", "short@1+0.05", "late@1+0.05", "unplug@1+0.3"]
)
def test_a_bridge_that_fails_makes_every_finger_invalid_at_once_and_is_brought_back(
    fault,
):
    bench = started(fault)
    found = bad(bench.read_for(2.5))
    assert found[0].t_ns < 1e9 + 2 * PERIOD_NS
    assert not found[0].valid.any()
    assert np.isnan(found[0].values).all()
    assert found[-1].t_ns < 1e9 + 0.3e9 + 0.15e9
    assert bench.messages[-1].endswith("good again")


@pytest.mark.hard_case(
    "What comes from outside",
    "a reply that comes late",
    elsewhere="it is taken for the reply to the next request",
    here="two marks alternate in the requests, and a bridge that failed is drained first",
)
def test_a_late_reply_never_answers_the_next_question():
    field_ut = np.array([[[0, 0, 1000.0]] * 6, [[0, 0, 30000.0]] * 6])
    bench = started("late@1+0.02", track=Track(np.array([0.9, 1.1]), field_ut))
    readings = bench.read_for(2.0)
    for reading in readings:
        if reading.valid.all():
            expected = np.interp(
                reading.t_ns * 1e-9 - 0.0025, [0.9, 1.1], [1000.0, 30000.0]
            )
            assert np.abs(reading.values[2::3] - expected).max() < 1200.0


@CORRUPT_READING.mark
def test_a_wire_that_flips_bits_costs_readings_and_the_hand_is_whole_afterwards():
    readings = started("noise@1+2").read_for(4.0)
    found = bad(readings)
    # of two seconds, a flipped bit costs the readings it strikes and no more
    assert 3 < len(found) < len(readings) / 8
    assert found[0].t_ns >= 1e9
    assert found[-1].t_ns < 3.2e9


def test_a_field_at_the_end_of_the_range_is_not_believed():
    bench = started(track=Track(np.array([0.0]), np.full((1, 6, 3), 60e3)))
    assert bench.read_for(0.05)[-1].why == ("saturated",) * 6


def test_a_missing_finger_is_reported_and_the_rest_goes_on():
    bench = Bench(faults=("nack:6@0+100",))
    bench.hand.start()
    reading = bench.read_for(0.5)[-1]
    assert reading.valid.tolist() == [True] * 5 + [False]
    assert bench.messages[0].startswith("finger 6: 0x22: does not answer")


def test_a_finger_that_comes_after_the_start_is_taken_in():
    bench = Bench(faults=("nack:6@0+0.5",))
    bench.hand.start()
    assert bench.read_for(1.0)[-1].valid.all()


def test_no_finger_at_all_is_an_error_with_the_next_command():
    bench = Bench(faults=tuple(f"nack:{k}@0+100" for k in range(1, 7)))
    with pytest.raises(DeviceNotFound, match="holdfast scan"):
        bench.hand.start()


def test_another_chip_at_an_address_is_refused_by_its_maker():
    bench = Bench(faults=("wrong:2@0+100",))
    with pytest.raises(WrongDevice, match=r"maker 0x0000.*no TMAG5273"):
        bench.hand.start()


RECOVERIES: dict[str, Callable[[int], str]] = {
    "nack": lambda s: f"nack:{s}",
    "por": lambda s: f"por:{s}",
    "sleep": lambda s: f"sleep:{s}",
    "frozen": lambda s: f"frozen:{s}",
    "stuck": lambda s: "stuck",
    "stall": lambda s: "stall",
    "short": lambda s: "short",
    "unplug": lambda s: "unplug",
}


def soak(scans: int) -> None:
    """Random faults, one every half second: the hand is whole again before the next."""
    rng = np.random.default_rng(7)
    seconds = scans / 150
    faults = []
    for at in np.arange(1.0, seconds - 1.0, 1.0):
        kind = list(RECOVERIES)[rng.integers(len(RECOVERIES))]
        what = RECOVERIES[kind](int(rng.integers(1, 7)))
        begins_s = at + 0.2 * rng.random()
        lasts_s = 0.1 * rng.random()
        faults.append(f"{what}@{begins_s:.4f}+{lasts_s:.4f}")
    bench = started(*faults)
    descriptors = len(os.listdir("/proc/self/fd"))
    start_ns = bench.clock.now_ns()
    words = set()
    quiet_bad = blocks = 0
    for k in range(scans):
        bench.clock.wait_until(start_ns + k * PERIOD_NS)
        reading = bench.hand.read()
        words |= set(reading.why)
        since_fault_s = (reading.t_ns * 1e-9) % 1.0
        quiet_bad += 0.6 < since_fault_s < 0.99 and not reading.valid.all()
        if k == scans // 5:
            bench.messages.clear()
            blocks = _allocated_blocks()
    bench.messages.clear()
    assert reading.valid.all()
    assert quiet_bad == 0
    assert words == {
        "",
        "nack",
        "missing",
        "settling",
        "stale",
        "stuck",
        "bridge",
        "lost",
        "garbage",
        "reset",
    }
    assert _allocated_blocks() - blocks < 5000
    assert len(os.listdir("/proc/self/fd")) == descriptors


def _allocated_blocks() -> int:
    gc.collect()
    return sys.getallocatedblocks()


def test_three_thousand_scans_with_random_faults_end_whole():
    soak(3_000)


@pytest.mark.soak
def test_a_million_scans_with_random_faults_end_whole():
    soak(1_000_000)


def test_a_machine_that_stood_still_in_the_middle_of_a_scan_takes_no_finger_for_stale():
    clock = Faltering()
    bench = started(clock=clock)
    assert not bad(bench.read_for(0.1))
    for _ in range(20):
        clock.lost_ns = 2 * STALE_NS
        held, after = (
            bench.hand.read(),
            bench.hand.read(),
        )  # the second is late, and begins at once
        assert held.valid.all()
        assert after.why == ("",) * 6
        bench.read_for(0.05)
    assert not bench.messages


@pytest.mark.parametrize("doubtful", [False, True])
@pytest.mark.parametrize("layout", [*LAYOUTS, "70/0:35,71/0:35,70/1:35,71/1:35,22,78"])
def test_a_plan_knows_the_place_of_every_mux_write_and_every_read(
    layout: str, doubtful: bool
) -> None:
    """A mux write that nothing looks at could fail, and the scan would read another finger."""
    fingers = read_layout(layout, FACTORY_ADDRESSES)
    reads = [Transfer(one.address, bytes([k]), 12) for k, one in enumerate(fingers)]
    plan = ScanPlanner(fingers).plan(reads, doubtful=doubtful)
    to_mux = [k for k, one in enumerate(plan.transfers) if one.address in MUX_ADDRESSES]
    writes = [k for k in to_mux if plan.transfers[k].write]
    assert [k for group in plan.groups for k in group.selects] == writes
    backs = [k for group in plan.groups for k in group.read_backs]
    assert backs == [k for k in to_mux if not plan.transfers[k].write]
    places = {k: at for group in plan.groups for k, at in group.fingers.items()}
    assert [plan.transfers[places[k]] for k in range(len(fingers))] == reads
    for group in plan.groups:
        assert all(at > max(group.selects, default=-1) for at in group.fingers.values())


# -- limits of layouts, exactly

LAYOUT, PLACE = "is not a layout", "at one place"


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("7:35", ""),
        ("8:35", LAYOUT),
        ("-1:35", LAYOUT),
        ("0:08", ""),
        ("0:07", LAYOUT),
        ("0:7f", ""),
        ("0:80", LAYOUT),
        ("70/0:35,77/0:35", ""),
        ("6f/0:35", LAYOUT),
        ("78/0:35", LAYOUT),
        ("71/:35", LAYOUT),
        ("71/35", LAYOUT),
        ("mux@77", ""),
        ("mux@78", LAYOUT),
        ("nine@71", LAYOUT),
        ("0:35,35,1:35", ""),
        ("0:35,0:35", PLACE),
        ("71/0:35,70", ""),
        ("71/0:35,71", PLACE),
        ("0:35>70", LAYOUT),
        ("0:22,0:72,72/1:44", PLACE),
    ],
)
def test_a_layout_has_channels_addresses_and_muxes_within_their_limits(
    text: str, says: str
) -> None:
    if not says:
        assert len(read_layout(text, FACTORY_ADDRESSES)) == (
            6 if "mux" in text else text.count(",") + 1
        )
        return
    with pytest.raises(UsageError, match=says):
        read_layout(text, FACTORY_ADDRESSES)


def test_a_chip_with_fewer_addresses_than_a_layout_names_another_layout() -> None:
    with pytest.raises(UsageError, match=r"needs 4 addresses .*; next: layout=mux6"):
        read_layout("mux", FACTORY_ADDRESSES[:2])
    assert len(read_layout("mux6", FACTORY_ADDRESSES[:2])) == 6
