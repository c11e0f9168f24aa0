"""Small slips in what people type and files hold: each is understood, or refused by name."""

from __future__ import annotations

import os
import tomllib
from pathlib import Path

import pytest

from holdfast.cli.options import read_settings
from holdfast.core.errors import CardError, ColumnError, DeviceNotFound, UsageError
from holdfast.core.hand_card import read_hand_card
from holdfast.core.hand_lines import LineRefused
from holdfast.core.schema import model_path
from holdfast.core.trial_file import read_trial
from holdfast.drivers.line_feeds import StreamFeed
from holdfast.drivers.lines import LineSource, SampleReader, map_of_names
from holdfast.drivers.virtual.faults import VirtualClock, read_fault
from holdfast.drivers.virtual.virtual_hand import VirtualHand
from holdfast.edge_runtime.wearer import read_intent
from holdfast.interop.map import toml_text
from holdfast.live.sources import LinesOptions, _column_map, source_url

SENSOR = """[[sensors]]
name = "{name}"
side = "{side}"
along_mm = {along}
"""


def reading_of(*lines: bytes) -> list[bool] | None:
    """Which sensors are valid in the last of some lines."""
    reader = SampleReader()
    reading = None
    for k, line in enumerate(lines):
        reading = reader.take(line, k)
    return None if reading is None else reading.valid.tolist()


@pytest.mark.parametrize("word", ["0", "0.0", "False", "false", "0e0", " 0"])
def test_a_sensor_is_not_valid_however_a_zero_is_written(
    tmp_path: Path, word: str
) -> None:
    names = b"Time,X1,Y1,Z1,X2,Y2,Z2,valid1,valid2"
    assert reading_of(names, f"1,1,2,3,4,5,6,{word},1".encode()) == [False, True]
    path = tmp_path / "trial.csv"
    rows = [f"{k / 100},1,2,3,4,5,6,{word},True" for k in range(9)]
    path.write_text("\n".join([names.decode(), *rows]) + "\n")
    assert read_trial(path).valid.tolist() == [[False, True]] * 9


def test_a_row_between_tabs_may_end_with_an_empty_cell() -> None:
    names = b"Time\tX1\tY1\tZ1\tX2\tY2\tZ2"
    assert reading_of(names, b"1\t1\t2\t3\t4\t5\t\r\n") == [True, False]


def test_an_input_that_is_at_its_end_is_told_without_a_wait() -> None:
    clock = VirtualClock()
    feed = StreamFeed("stdin", os.open(os.devnull, os.O_RDONLY))
    with pytest.raises(DeviceNotFound, match=r"ended before a sample came.*dev/null"):
        LineSource(feed, SampleReader(), clock, print)
    assert clock.now_ns() == 0


def test_more_sensors_than_a_hand_has_are_refused_with_the_limit() -> None:
    names = [f"{axis}{k}" for k in range(1, 14) for axis in "XYZ"]
    with pytest.raises(ColumnError, match="13 sensors, and 12 are the most"):
        map_of_names(names, "N")
    with pytest.raises(LineRefused, match="13 sensors, and 12 are the most"):
        reading_of(",".join(names).encode())


def test_a_map_of_more_sensors_than_a_hand_has_is_refused_before_a_source_opens(
    tmp_path: Path,
) -> None:
    sensors = "".join(
        f'[[sensors]]\nx = "X{k}"\ny = "Y{k}"\nz = "Z{k}"\n' for k in range(1, 14)
    )
    path = tmp_path / "map.toml"
    path.write_text(f'unit = "N"\n[time]\ncolumn = "Time"\n{sensors}')
    with pytest.raises(ColumnError, match="13 sensors, and 12 are the most"):
        _column_map(LinesOptions(map=str(path)))


def test_the_wearers_words_may_have_the_line_ends_of_windows(tmp_path: Path) -> None:
    path = tmp_path / "tactile.intent.csv"
    path.write_bytes(b"Time,host_ns,wants\r\n0.5,1,open\r\n0.7,2,close\r\n")
    assert [item.wants for item in read_intent(path)] == ["open", "close"]


def test_a_column_name_with_a_control_character_makes_a_map_that_can_be_read() -> None:
    table = {"column": "force\x7f\x01", "sensors": [{"x\x7f": "a"}]}
    assert tomllib.loads(toml_text(table)) == table


def test_a_fault_of_a_sensor_that_the_hand_lacks_is_refused_with_the_number() -> None:
    fault = read_fault("nack:7@1")
    assert fault.sensor == 7
    with pytest.raises(UsageError, match="sensor 7, and the hand has 6"):
        VirtualHand(VirtualClock(), faults=[fault])


@pytest.mark.parametrize("baud", [0, 1, 99999999999])
def test_a_rate_that_no_port_has_is_refused_before_the_port_is_opened(
    baud: int,
) -> None:
    with pytest.raises(UsageError, match="baud"):
        source_url(f"serial:///dev/ttyX?baud={baud}")


def test_a_folder_does_not_hide_a_shipped_model(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("holdfast-150hz").mkdir()
    assert model_path("holdfast-150hz").is_file()
    Path("holdfast-150hz/artifact.json").touch()
    assert model_path("holdfast-150hz") == Path("holdfast-150hz"), "an artifact"


@pytest.mark.parametrize(
    ("second", "says"),
    [
        ({"name": "thumb", "along": 5}, "contacts have name thumb"),
        ({"name": "index", "along": 5}, "contacts have place"),
    ],
)
def test_two_sensors_of_one_name_or_one_place_are_no_hand(
    tmp_path: Path, second: dict[str, object], says: str
) -> None:
    card = SENSOR.format(name="thumb", side="thumb", along=5)
    other = {"name": "ring", "side": "opposing", "along": 5}
    if second["name"] == "index":
        card += SENSOR.format(name="index", side="thumb", along=5)
        card += SENSOR.format(**other)
    else:
        card += SENSOR.format(**(other | second))
    path = tmp_path / "hand.toml"
    path.write_text(card)
    with pytest.raises(CardError, match=says):
        read_hand_card(path)


def test_a_hand_card_in_the_settings_is_looked_for_beside_them(tmp_path: Path) -> None:
    (tmp_path / "mine.toml").touch()
    settings = tmp_path / "holdfast.toml"
    settings.write_text('hand = "mine.toml"')
    assert read_settings(settings)["hand"] == os.fspath(tmp_path / "mine.toml")
    settings.write_text('hand = "six-fingertips"')
    assert read_settings(settings)["hand"] == "six-fingertips"
