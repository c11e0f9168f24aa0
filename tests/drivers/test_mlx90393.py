"""The MLX90393: a hand of these chips, what of their answers counts, and the emulated chip against
the numbers that its public data sheet and public drivers agree on."""

from __future__ import annotations

from contextlib import closing

import numpy as np
import pytest
from foreign_chips import Registers
from hand_bench import PERIOD_NS, Bench, bad, started
from hazard_marks import CORRUPT_READING, FOREIGN_CHIP

from holdfast.cli.main import main
from holdfast.core.errors import DeviceNotFound, UsageError, WrongDevice
from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.chips import CHIPS, STALE_NS, driver_of, emulation_of
from holdfast.drivers.fingers import FingerState
from holdfast.drivers.layout import LAYOUTS, Finger
from holdfast.drivers.mlx90393 import registers as chip
from holdfast.drivers.mlx90393.driver import AVERAGES, Driver
from holdfast.drivers.mlx90393.emulation import Chip
from holdfast.drivers.scan import look_at
from holdfast.drivers.virtual.faults import Faults, VirtualClock
from holdfast.drivers.virtual.virtual_hand import Track, Wire
from holdfast.live.sources import open_live

A = chip.ADDRESSES[0]


def hand(*faults: str, field_ut: float = 0.0, **options: object) -> Bench:
    """A started hand of six, all in the same field in x, y and z."""
    track = Track(np.array([0.0]), np.full((1, 6, 3), field_ut))
    return started(*faults, chip="mlx90393", **{"track": track, **options})


# -- a hand


@pytest.mark.parametrize("layout", LAYOUTS)
def test_six_fingers_report_the_field_at_their_magnets(layout: str) -> None:
    field_ut = np.arange(-9.0, 9.0).reshape(1, 6, 3) * 5_000.0
    bench = hand(track=Track(np.array([0.0]), field_ut), layout=layout)
    assert bench.hand.read().why == ("",) * 6, "a start waits until readings count"
    reading = bench.read_for(0.05)[-1]
    assert reading.valid.all()
    np.testing.assert_allclose(reading.values, field_ut.reshape(-1), atol=40.0)
    about = bench.hand.about()
    assert (about["chip"], about["averages"]) == ("MLX90393", 8)


@pytest.mark.parametrize(
    ("fault", "why"),
    [
        ("nack:4@1+0.1", "nack"),
        ("por:4@1", "reset"),
        ("sleep:4@1", "reset"),
        ("wrong:4@1+0.1", "garbage"),
    ],
)
def test_a_chip_that_fails_costs_only_itself_and_comes_back(
    fault: str, why: str
) -> None:
    readings = hand(fault).read_for(1.5)
    found = bad(readings)
    assert found == bad(readings, finger=4)
    assert found[0].why[3] == why
    assert found[0].t_ns < 1e9 + 2 * PERIOD_NS
    assert found[-1].t_ns < 1.1e9 + 0.1e9


@pytest.mark.parametrize("fault", ["frozen:2@1+0.3", "diag:2@1+0.3"])
def test_a_chip_that_converts_no_more_counts_at_no_time_and_is_soon_stale(
    fault: str,
) -> None:
    readings = hand(fault).read_for(1.6)
    found = bad(readings)
    assert found == bad(readings, finger=2)
    assert 1e9 <= found[0].t_ns < 1e9 + 2 * PERIOD_NS
    assert found[0].why[1] == "settling"
    stale = next(one for one in found if one.why[1] == "stale")
    assert stale.t_ns - 1e9 <= STALE_NS + 2 * PERIOD_NS
    assert np.diff([one.t_ns for one in found]).max() < 1.5 * PERIOD_NS
    assert found[-1].t_ns < 1.3e9 + 0.1e9


@pytest.mark.parametrize("at_s", [0.9985, 1.0, 1.0007, 1.0014, 1.003])
def test_a_chip_that_lost_its_power_gives_no_reading_of_another_scale(
    at_s: float,
) -> None:
    for reading in hand(f"por:5@{at_s}", field_ut=9_000.0).read_for(1.2):
        assert np.abs(reading.values.reshape(-1, 3)[reading.valid] - 9e3).max() < 50.0


@CORRUPT_READING.mark
def test_a_wire_that_flips_bits_costs_readings_and_the_hand_is_whole_afterwards() -> (
    None
):
    readings = hand("noise@1+1").read_for(2.5)
    found = bad(readings)
    assert 3 < len(found) < len(readings) / 6
    assert found[0].t_ns >= 1e9
    assert found[-1].t_ns < 2.2e9


@pytest.mark.parametrize("field_ut", [49_500.0, -49_500.0, 1e6, -1e6])
def test_a_field_beyond_the_range_is_not_believed(field_ut: float) -> None:
    assert hand(field_ut=field_ut).read_for(0.05)[-1].why == ("saturated",) * 6
    assert hand(field_ut=0.98 * np.sign(field_ut) * 49e3).read_for(0.05)[-1].valid.all()


def test_a_hand_that_is_read_faster_than_it_converts_repeats_no_reading() -> None:
    bench = hand()
    readings = bench.read_for(0.5, rate_hz=450.0)
    assert {word for one in readings for word in one.why} == {"", "settling"}
    counted = np.array([one.values[:3] for one in readings if one.valid[0]])
    least = 0.5 / chip.conversion_s(0, 3) - 5
    assert least < len(counted) < 0.5 * 450 * 0.9
    assert (np.diff(counted, axis=0) != 0.0).any(axis=1).all()


def test_a_slow_reader_gets_the_newest_conversion() -> None:
    ramp = Track(
        np.array([0.0, 4.0]), np.array([np.zeros((6, 3)), np.full((6, 3), 4e4)])
    )
    readings = hand(track=ramp).read_for(2.0, rate_hz=10.0)
    assert not bad(readings)
    for one in readings:
        assert abs(one.values[0] - 1e-5 * one.t_ns) < 80.0, "8 ms and the noise"


# -- what may be asked


def test_a_scan_names_the_sensors_and_their_layout(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["scan", "virtual://ft232h?chip=mlx90393"]) == 0
    out = capsys.readouterr().out
    assert out.count("MLX90393 (49 mT)") == 6
    assert "layout=0:0c,0:0d,0:0e,0:0f,1:0c,1:0d " in out


def test_a_scan_for_another_chip_leaves_a_burst_as_it_was() -> None:
    bench = hand()
    assert bench.hand._bus is not None
    found = look_at(bench.hand._bus, driver_of("tmag5273"), lambda pause_s: None)
    bench.hand._driven.forget_masks()
    assert {one.kind for one in found} == {"mux", "unknown"}
    assert not bad(bench.read_for(0.1))


def test_a_scan_stops_a_hand_that_is_read_and_the_hand_comes_back() -> None:
    bench = hand()
    assert bench.hand._bus is not None
    look_at(bench.hand._bus, Driver(), lambda pause_s: None)
    bench.hand._driven.forget_masks()
    readings = bench.read_for(1.0)
    assert readings[0].why == ("reset",) * 6
    assert readings[-1].valid.all()


@FOREIGN_CHIP.mark
@pytest.mark.parametrize("memory", [bytes(256), b"\xff" * 256, bytes(range(256))])
def test_a_chip_with_registers_at_a_sensor_s_own_address_is_only_read(
    memory: bytes,
) -> None:
    foreign = Registers(A, memory)
    bench = Bench(chip="mlx90393")
    bench.virtual.wire.targets[:] = [foreign]
    before = foreign.state
    with closing(bench.open_bus()) as bus:
        (found,) = look_at(bus, Driver(), lambda pause_s: None)
        with pytest.raises(WrongDevice, match="no MLX90393"):
            Driver().identify(bus, A, lambda pause_s: None)
    assert (found.kind, foreign.state) == ("unknown", before)


@FOREIGN_CHIP.mark
def test_a_chip_at_no_address_of_the_sensor_is_asked_nothing() -> None:
    foreign = Registers(0x40, bytes(range(256)))
    bench = Bench(chip="mlx90393")
    bench.virtual.wire.targets[:] = [foreign]
    with closing(bench.open_bus()) as bus:
        (found,) = look_at(bus, Driver(), lambda pause_s: None)
    assert found.trouble == "not asked: no address of a MLX90393"


def test_another_chip_at_an_address_starts_no_hand_and_a_silent_one_is_reported() -> (
    None
):
    with pytest.raises(WrongDevice, match="its mode does not follow commands"):
        Bench(faults=("wrong:2@0+100",), chip="mlx90393").hand.start()
    bench = Bench(faults=("nack:6@0+100",), chip="mlx90393")
    bench.hand.start()
    assert bench.read_for(0.1)[-1].valid.tolist() == [True] * 5 + [False]
    assert bench.messages[0].startswith("finger 6: 0x0d: does not answer")
    nothing = tuple(f"nack:{k}@0+100" for k in range(1, 7))
    with pytest.raises(DeviceNotFound):
        Bench(faults=nothing, chip="mlx90393").hand.start()


# -- answers, one by one


def answer(status: int, x: int = 0x4001, y: int = 0x4002, z: int = 0x4003) -> Reply:
    return Reply(chip.LAYOUT.pack(status, x, y, z), acked=True)


NEW = answer(0x82)


@CORRUPT_READING.mark
@pytest.mark.parametrize(
    ("reply", "why"),
    [
        (NEW, ""),
        (answer(0x8A), ""),  # a memory bit that was corrected
        (answer(0x92), "settling"),
        (answer(0x86), "reset"),
        (answer(0x02), "reset"),
        (answer(0xA2), "reset"),
        (answer(0xC2), "reset"),
        (answer(0x83), "garbage"),
        (answer(0x80), "garbage"),
        (answer(0x82, x=0x4000 + 16311), "saturated"),
        (answer(0x82, y=0x4000 - 16311), "saturated"),
        (answer(0x82, z=0x4000 + 10123), "saturated"),
        (answer(0x82, 0x4000 + 16310, 0x4000 - 16310, 0x4000 - 10122), ""),
        (answer(0, 0, 0, 0), "garbage"),
        (answer(0xFF, 0xFFFF, 0xFFFF, 0xFFFF), "garbage"),
        (Reply(b"", acked=False), "nack"),
        (Reply(bytes(6), acked=True), "nack"),
    ],
)
def test_each_answer_that_is_no_reading_has_its_word(reply: Reply, why: str) -> None:
    state = FingerState(Finger(A), Driver())
    state.brought_up(1, 0)
    assert (state.judge(NEW, 3_000_000)[1], state.settled) == ("settling", True)
    assert state.judge(NEW, 6_000_000)[1] == ""
    found, word = state.judge(reply, 9_000_000)
    assert word == why
    assert (found is None) == (why == "nack")


@pytest.mark.parametrize(("after_ns", "why"), [(0, "settling"), (1, "stale")])
def test_an_answer_without_a_new_conversion_is_stale_after_twenty_milliseconds(
    after_ns: int, why: str
) -> None:
    state = FingerState(Finger(A), Driver())
    state.brought_up(1, 0)
    state.judge(NEW, 3_000_000)
    state.judge(NEW, 6_000_000)
    assert state.judge(answer(0x92), 6_000_000 + STALE_NS + after_ns)[1] == why
    assert state.settled == (why == "settling")
    # after a pause in which it was stale, one more result is waited for
    words = [state.judge(NEW, 40_000_000 + k)[1] for k in range(2)]
    assert words == (["settling", ""] if why == "stale" else ["", ""])


# -- numbers


@pytest.mark.parametrize(
    ("osr", "dig_filt", "axis_us"),
    [(0, 0, 259), (0, 3, 707), (1, 2, 835), (3, 4, 9283), (3, 7, 66627)],
)
def test_a_conversion_takes_as_long_as_public_drivers_say(
    osr: int, dig_filt: int, axis_us: int
) -> None:
    assert chip.conversion_s(osr, dig_filt) == pytest.approx(1e-6 * (680 + 3 * axis_us))


@pytest.mark.parametrize("averages", AVERAGES)
def test_each_number_of_averages_gives_readings_at_150_hz(averages: int) -> None:
    url = f"virtual://ft232h?chip=mlx90393&averages={averages}"
    clock = VirtualClock()
    with closing(open_live(url, clock=clock, report=lambda line: None)) as source:
        for k in range(10):
            clock.wait_until(10**9 + k * PERIOD_NS)
            reading = source.read()
            assert reading is not None
            assert reading.valid.all()


def test_a_number_of_averages_or_a_chip_that_is_not_there_is_refused() -> None:
    with pytest.raises(UsageError, match="choose 4, 8, 16"):
        driver_of("mlx90393", 32)
    with pytest.raises(UsageError, match="chip=tmag5273 or chip=mlx90393"):
        driver_of("mlx90394")


@pytest.mark.parametrize("name", CHIPS)
def test_a_row_of_the_table_has_a_driver_and_an_emulation_of_one_chip(
    name: str,
) -> None:
    driver = driver_of(name)
    assert driver.name.lower() == name
    assert driver.addresses == emulation_of(name).addresses
    assert len(set(driver.addresses)) >= 4, "four fingers share a channel of layout mux"


# -- the emulated chip on a wire


class OnWire:
    """One emulated chip, alone on a wire, in a constant field."""

    def __init__(self, field_ut: tuple[float, float, float]) -> None:
        self.clock = VirtualClock(5)
        faults = Faults(self.clock)
        self.chip = Chip(1, A, lambda now_s: field_ut, self.clock, faults)
        self.wire = Wire([self.chip])

    def ask(self, *command: int, size: int = 1) -> list[int]:
        """A command and its answer."""
        self.wire.start()
        assert all(self.wire.write(byte) for byte in (A << 1, *command))
        self.wire.start()
        assert self.wire.write(A << 1 | 1)
        answered = [self.wire.read() for _ in range(size)]
        self.wire.stop()
        return answered

    def measured(self) -> list[int]:
        """Start a burst, wait, and read x, y, z."""
        self.ask(chip.START_BURST)
        self.clock.spend(10**9)
        data = bytes(self.ask(chip.READ_MEASUREMENT, size=7)[1:])
        return [int(one) for one in np.frombuffer(data, ">u2")]


def test_the_status_says_reset_once_then_the_mode_and_what_is_not_new() -> None:
    on = OnWire((0.0, 0.0, 0.0))
    assert on.ask(chip.NOP) == [chip.RESET]
    assert on.ask(chip.READ_REGISTER, 0, size=3) == [0x00, 0x00, 0x7C]
    assert on.ask(chip.START_BURST) == [0x80]
    on.clock.spend(round(1e9 * chip.conversion_s(0, 0)))
    assert on.ask(chip.READ_MEASUREMENT, size=7)[0] == 0x82
    assert on.ask(chip.READ_MEASUREMENT, size=7)[0] == 0x92
    assert on.ask(0x3E) == [0x90], "a command that it does not know"
    assert on.ask(chip.EXIT) == [0x00]
    on.chip.power_on()
    assert on.ask(chip.NOP) == [chip.RESET]


@pytest.mark.parametrize(
    ("gain", "resolution", "zero", "scale_ut"),
    [
        (7, 0, 0, (0.150, 0.242)),
        (7, 1, 0, (0.300, 0.484)),
        (5, 2, 0x8000, (1.001, 1.613)),
        (3, 3, 0x4000, (3.004, 4.840)),
        (0, 3, 0x4000, (6.009, 9.680)),
    ],
)
def test_a_field_is_counted_in_the_steps_of_public_drivers(
    gain: int, resolution: int, zero: int, scale_ut: tuple[float, float]
) -> None:
    on = OnWire((4_000.0, -3_000.0, 6_000.0))
    res = resolution * (1 << 5 | 1 << 7 | 1 << 9)
    on.ask(chip.WRITE_REGISTER, 0, gain << 4 | 0xC, 0 << 2)
    on.ask(chip.WRITE_REGISTER, res >> 8, res & 0xFF, 2 << 2)
    counts = [(one - zero + 0x8000) % 0x10000 - 0x8000 for one in on.measured()]
    steps = (scale_ut[0], scale_ut[0], scale_ut[1])
    found = [count * step for count, step in zip(counts, steps, strict=True)]
    assert found == pytest.approx([4e3, -3e3, 6e3], rel=3e-3, abs=10.0)


def test_the_driver_leaves_bits_of_others_alone() -> None:
    bench = Bench(chip="mlx90393")
    (one, *_) = bench.virtual.chips
    assert isinstance(one, Chip)
    one.registers[0] |= 0x1200
    one.registers[1] |= 0x6000
    bench.hand.start()
    assert [hex(word) for word in one.registers[:3]] == ["0x123c", "0x6000", "0x7ec"]
    assert bench.hand._bus is not None
    bench.hand._bus.scan([Transfer(0x70, b"\x01")])
    assert Driver().health(bench.hand._bus, A) == ""
