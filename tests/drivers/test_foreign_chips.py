"""Chips of others on the bus stay as they were, byte for byte, whatever looks for ours; the
emulated wire and mux that they are on."""

from __future__ import annotations

from contextlib import closing
from typing import Any

import pytest
from foreign_chips import Ads1115, Expander, Pca9685, Registers, eeprom
from hand_bench import Bench
from hazard_marks import FOREIGN_CHIP, WIRING

from holdfast.cli.main import main
from holdfast.core.errors import DeviceNotFound, WrongDevice
from holdfast.drivers.chips import driver_of
from holdfast.drivers.layout import read_layout
from holdfast.drivers.scan import as_layout, look_at
from holdfast.drivers.tmag5273.registers import FACTORY_ADDRESSES
from holdfast.drivers.virtual.virtual_hand import Mux

TMAG5273 = driver_of("tmag5273")
SIX = "0:35,0:22,0:78,0:44,1:35,1:22"


def pause(bench: Bench) -> Any:
    return lambda seconds: bench.clock.spend(round(1e9 * seconds))


def scan(bench: Bench) -> list[Any]:
    with closing(bench.open_bus()) as bus:
        return look_at(bus, TMAG5273, pause(bench))


def with_chips(*chips: Any, **options: Any) -> tuple[Bench, list[bytes]]:
    """A hand's bus with more chips on it, and what they hold."""
    bench = Bench(**options)
    bench.virtual.wire.targets.extend(chips)
    return bench, [chip.state for chip in chips]


@FOREIGN_CHIP.mark
def test_a_scan_leaves_an_eeprom_a_pwm_driver_a_converter_and_an_expander_as_they_were():
    chips = [eeprom(), Pca9685(), Ads1115(), Expander()]
    bench, before = with_chips(*chips)
    bench.virtual.mux.address = 0x71  # the PWM driver answers at 0x70 too
    found = scan(bench)
    assert [chip.state for chip in chips] == before
    assert as_layout(found, FACTORY_ADDRESSES) == ",".join(
        f"71/{place}" for place in SIX.split(",")
    )
    unknown = {one.address: one.trouble for one in found if one.kind == "unknown"}
    assert set(unknown) == {0x50, 0x40, 0x48, 0x20, 0x70}
    assert "not identified" in unknown[0x20]
    assert "no TMAG5273" in unknown[0x50]


@FOREIGN_CHIP.mark
@pytest.mark.parametrize("pointer", [0, 1, 2, 6, 250])
@pytest.mark.parametrize("increments", [False, True])
@pytest.mark.parametrize("address", [0x40, 0x73])
def test_a_pwm_driver_is_taken_for_no_mux_wherever_its_pointer_is(
    address, increments, pointer
):
    chip = Pca9685(address)
    bench, before = with_chips(chip)
    bench.virtual.wire.targets.remove(bench.virtual.mux)
    chip.pointer = pointer
    chip.increments = increments
    assert [one.kind for one in scan(bench)] == ["unknown"] * 2
    assert [chip.state] == before


@FOREIGN_CHIP.mark
@pytest.mark.parametrize("address", FACTORY_ADDRESSES)
@pytest.mark.parametrize("memory", [bytes(256), b"\xff" * 256, bytes(range(256))])
def test_a_chip_with_registers_at_a_sensor_s_own_address_is_only_read(address, memory):
    chip = Registers(address, memory)
    bench, before = with_chips(chip)
    bench.virtual.wire.targets.remove(bench.virtual.mux)
    assert [one.kind for one in scan(bench)] == ["unknown"]
    with (
        closing(bench.open_bus()) as bus,
        pytest.raises(WrongDevice, match="no TMAG5273"),
    ):
        TMAG5273.identify(bus, address, pause(bench))
    assert [chip.state] == before


@FOREIGN_CHIP.mark
def test_a_layout_that_names_a_foreign_chip_s_address_starts_no_hand_and_leaves_it_as_it_was():
    chip = eeprom(0x35)
    bench, before = with_chips(chip, layout="35,0:22", on_wire="mux")
    with pytest.raises(WrongDevice, match="no TMAG5273"):
        bench.hand.start()
    assert [chip.state] == before


@FOREIGN_CHIP.mark
def test_a_chip_that_is_no_mux_at_the_mux_s_address_is_written_to_by_no_hand():
    chip = Pca9685()
    bench, before = with_chips(chip)
    bench.virtual.wire.targets.remove(bench.virtual.mux)
    with pytest.raises(WrongDevice, match=r"0x70: another chip, no mux.*mux@71"):
        bench.hand.start()
    assert [chip.state] == before


# -- muxes


@WIRING.mark
def test_every_mux_is_looked_behind_and_the_layout_names_it():
    bench = Bench()
    first = Mux([[bench.virtual.chips[0]]], 0x70)
    second = Mux([[], [bench.virtual.chips[1]]], 0x77)
    bench.virtual.wire.targets[:] = [first, second]
    found = scan(bench)
    layout = as_layout(found, FACTORY_ADDRESSES)
    assert layout == "0:35,77/1:22"
    assert [one.address for one in found if one.kind == "mux"] == [0x70, 0x77]
    assert (first.control, second.control) == (0, 0)
    bench.hand = type(bench.hand)(
        bench.open_bus,
        read_layout(layout, FACTORY_ADDRESSES),
        now_ns=bench.clock.now_ns,
        pause=pause(bench),
        say=bench.messages.append,
    )
    bench.hand.start()
    assert all(reading.valid.all() for reading in bench.read_for(0.1))


@WIRING.mark
def test_a_mux_that_is_somewhere_else_is_named_with_its_pins():
    bench = Bench()
    bench.virtual.mux.address = 0x71
    with pytest.raises(DeviceNotFound, match=r"0x70: no mux answers.*A0 to A2.*mux@71"):
        bench.hand.start()


@WIRING.mark
@pytest.mark.parametrize("layout", ["mux", "mux6"])
def test_a_named_layout_has_its_mux_where_the_url_says(layout, capsys):
    assert main(["scan", f"virtual://ft232h?layout={layout}@74"]) == 0
    out = capsys.readouterr().out
    assert "  74  " in out
    assert "layout=74/0:35," in out
    assert "a scan takes" in out


# -- what tells a sensor in 1-byte mode from another chip


# -- the emulated wire and mux
