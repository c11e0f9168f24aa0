"""What a survey of a bus says: its rate, and where each chip is."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from holdfast.drivers import scan
from holdfast.drivers.bus import Reply, Transfer
from holdfast.drivers.chips import driver_of
from holdfast.drivers.scan import BusDevice, as_layout, look_at
from holdfast.drivers.tmag5273.emulation import Chip
from holdfast.drivers.tmag5273.registers import FACTORY_ADDRESSES, REGISTERS

TMAG5273 = driver_of("tmag5273")


class Version2(Chip):
    """Emulated chips of the wider ranges."""

    version = 2


def test_a_survey_says_the_layout_and_how_long_a_scan_takes(make: Any) -> None:
    bench = make("native")
    found = scan.survey("i2c://1", bench.bus, TMAG5273, bench.wait_s, frozenset())
    assert found.layout == "0:35,0:22,0:78,0:44,1:35,1:22"
    assert found.scan_s is not None
    rate = f"a scan takes {1e3 * found.scan_s:.2f} ms ({1.0 / found.scan_s:.0f} Hz)"
    assert rate in found.lines()[-1]


def test_sensors_are_in_the_order_of_muxes_channels_and_fingers() -> None:
    def sensor(address: int, channel: int | None, mux: int = 0x70) -> BusDevice:
        return BusDevice(address, channel, "sensor", "TMAG5273", mux=mux)

    found = [
        *(sensor(one, 1) for one in (0x51, 0x50, 0x44, 0x78, 0x22, 0x35)),
        sensor(0x35, 0, 0x71),
        sensor(0x35, 0),
        sensor(0x44, None, 0x77),
        BusDevice(0x36, 0, "unknown", "unknown"),
    ]
    layout = "44,0:35,1:35,1:22,1:78,1:44,1:50,1:51,71/0:35"
    assert as_layout(found, FACTORY_ADDRESSES) == layout


def test_what_a_chip_reports_as_wrong_is_in_its_line(make: Any) -> None:
    bench = make("native", emulation=Version2)
    chips = bench.hand.chips
    address = REGISTERS["DEVICE_STATUS"].address
    for chip, byte in zip(chips, (0x10, 0x08, 0x04, 0x02, 0x01, 0x0B), strict=True):
        chip._bytes[address] = byte
    chips[0]._bytes[REGISTERS["CONV_STATUS"].address] |= 0x02
    found = [
        one
        for one in look_at(bench.bus, TMAG5273, bench.wait_s)
        if one.kind == "sensor"
    ]
    assert {(one.what, one.trouble) for one in found} == {
        ("TMAG5273 A2 (133/266 mT)", "DIAG_STATUS"),
        ("TMAG5273 B2 (133/266 mT)", "OSC_ER"),
        ("TMAG5273 C2 (133/266 mT)", ""),
        ("TMAG5273 D2 (133/266 mT)", "OTP_CRC_ER"),
        ("TMAG5273 A2 (133/266 mT)", "VCC_UV_ER"),
        ("TMAG5273 B2 (133/266 mT)", "OSC_ER, OTP_CRC_ER, VCC_UV_ER"),
    }


class Leaving:
    """A bus with one chip at 0x40, which answers reads of one byte and nothing else."""

    name = "leaving"

    def __init__(self) -> None:
        self.asked: list[Transfer] = []

    def scan(self, transfers: Sequence[Transfer]) -> list[Reply]:
        self.asked += transfers
        there = [one.address == 0x40 and one.read == 1 for one in transfers]
        return [Reply(b"\x00" if one else b"", acked=one) for one in there]

    def clear(self) -> None:
        """Nothing to free."""

    close = clear


def test_a_chip_that_is_gone_before_it_is_known_is_sent_nothing_to_its_registers() -> (
    None
):
    bus = Leaving()
    (found,) = look_at(bus, TMAG5273, lambda pause_s: None)
    assert (found.place, found.kind) == ("40", "unknown")
    assert "not identified for its safety" in found.trouble
    assert not [one for one in bus.asked if one.write]
    # a user who says that a sensor is there has it asked
    (named,) = look_at(bus, TMAG5273, lambda pause_s: None, frozenset({0x40}))
    assert named.trouble == "does not answer"
    assert [one for one in bus.asked if one.write] == [Transfer(0x40, b"\x0c", 4)] * 2
