"""The column map: which columns are time and sensors, for imports and for live sources alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.column_map import (
    ColumnMap,
    SensorColumns,
    TimeColumn,
    column_map_of,
    flat_fields,
    read_column_map,
)
from holdfast.core.contract import UNIT_OF
from holdfast.core.errors import CardError, ColumnError, NotANumber
from holdfast.core.toml_lines import toml_text

MAP = """\
unit = "mN"

[time]
column = "millis"
unit = "ms"

[[sensors]]
x = "a.x"
y = "a.y"
z = "-a.z"

[[sensors]]  # the finger
x = "b.x"
y = "b.y"
z = "b.z"
"""
ROW = {"millis": 1500, "a.x": 1000, "a.y": "2000", "a.z": 3000, "b.x": None} | {
    "b.y": "",
    "b.z": 1.5,
}


def test_a_row_becomes_channels_in_the_unit_of_a_model() -> None:
    columns = column_map_of(MAP)
    assert columns.unit_of_values == "N"
    values = columns.values_of(ROW)
    np.testing.assert_allclose(values, [1, 2, -3, np.nan, np.nan, 0.0015])
    assert columns.stamp_ns(ROW, 0) == 1_500_000_000


def test_a_table_becomes_the_same_as_its_rows() -> None:
    columns = column_map_of(MAP)
    table = {name: np.arange(4.0) + k for k, name in enumerate(columns.columns)}
    rows = [{name: cells[t] for name, cells in table.items()} for t in range(4)]
    by_row = [columns.values_of(row) for row in rows]
    np.testing.assert_array_equal(columns.values_of(table), by_row)
    stamps = [columns.stamp_ns(row, 0) for row in rows]
    assert columns.stamps_ns(table, 4).tolist() == stamps


@pytest.mark.parametrize("stamp", [1_700_000_000_123_456_789, "1700000000123456789"])
def test_a_stamp_in_nanoseconds_keeps_its_digits(stamp: int | str) -> None:
    columns = column_map_of(MAP.replace('"ms"', '"ns"'))
    assert columns.stamp_ns({**ROW, "millis": stamp}, 0) == int(stamp)
    table = {"millis": np.array([int(stamp)])}
    assert columns.stamps_ns(table, 1).tolist() == [int(stamp)]


def test_rows_are_counted_where_the_map_has_a_rate() -> None:
    counted = MAP.replace('column = "millis"\nunit = "ms"', "rate_hz = 100")
    columns = column_map_of(counted)
    assert columns.stamps_ns({}, 3).tolist() == [0, 10_000_000, 20_000_000]
    assert columns.stamp_ns({}, 2) == 20_000_000


def test_a_file_has_no_times_of_arrival_and_a_sender_does() -> None:
    columns = column_map_of(
        MAP.replace('column = "millis"\nunit = "ms"', "arrival = true")
    )
    assert columns.stamp_ns(ROW, 7) is None
    with pytest.raises(ColumnError, match="line 4: a file has no times of arrival"):
        columns.stamps_ns({}, 3)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('unit = "mN"', 'unit = "kg"', "line 1: unit = 'kg'; next: allowed: N, mN, gf"),
        ('unit = "ms"', 'unit = "min"', "line 5: time.unit = 'min'"),
        ('z = "-a.z"', "z = 3", r"line 10: sensors\[0\].z = 3"),
        ('z = "-a.z"', "", r"line 7: sensors\[0\].z = None"),
        ('z = "b.z"', 'z = "a.z"', r"line 15: .* allowed: not that of sensors\[0\].z"),
        ('z = "b.z"', 'z = "b.z"\nw = "q"', r"line 16: sensors\[1\].w is not known"),
        ('column = "millis"', "rate_hz = 0", r"line 5: time.unit = 'ms'"),
        ('column = "millis"\nunit = "ms"', "arrival = 1", r"time.arrival = 1; next"),
        ("[time]", "[times]", "line 3: times is not known"),
        ('unit = "mN"', 'unit = "mN', "not valid TOML"),
    ],
)
def test_an_error_names_the_file_the_line_and_the_key(
    tmp_path: Path, old: str, new: str, what: str
) -> None:
    path = tmp_path / "lab.toml"
    assert old in MAP
    path.write_text(MAP.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CardError, match=what) as error:
        read_column_map(path)
    assert error.value.where == str(path)


def test_a_column_that_is_not_there_is_named_with_its_line() -> None:
    columns = column_map_of(MAP)
    with pytest.raises(
        ColumnError, match=r"no column a\.y \(line 9\), b\.z \(line 15\)"
    ):
        columns.values_of({"millis": 0, "a.x": 1, "a.z": 1, "b.x": 1, "b.y": 1})


def test_text_in_a_column_of_numbers_is_refused() -> None:
    with pytest.raises(NotANumber, match=r"column a\.x: '1,5' is no number"):
        column_map_of(MAP).values_of({**ROW, "a.x": "1,5"})


def test_a_hand_card_of_other_sensors_is_refused() -> None:
    columns = column_map_of(f'hand = "two-pad-gripper"\n{MAP}')
    hand = columns.hand_card()
    assert hand is not None
    assert hand.n_sensors == 2
    six = column_map_of(f'hand = "two-pad-gripper"\n{MAP.rpartition("[[sensors]]")[0]}')
    with pytest.raises(
        CardError, match="line 1: the hand two-pad-gripper has 2 sensors"
    ):
        six.hand_card()


def test_the_tables_of_an_import_are_left_to_it() -> None:
    text = MAP + '\n[trials]\npath = "{person}/{n}.csv"\n\n[trials.gap]\nmost_s = 2\n'
    columns = column_map_of(text)
    assert columns.tables == {
        "trials": {"path": "{person}/{n}.csv", "gap": {"most_s": 2}}
    }
    assert columns.place_of("trials.gap.most_s") == "line 21"


NAMES = st.text(min_size=1, max_size=12).filter(
    lambda name: name.strip("-") and "\0" not in name
)


@settings(max_examples=30)
@given(
    st.lists(NAMES, min_size=6, max_size=6, unique_by=lambda name: name.lstrip("-")),
    st.sampled_from(sorted(UNIT_OF)),
    st.sampled_from([None, "s", "ms", "us", "ns"]),
)
def test_what_is_written_is_read_back(
    names: list[str], unit: str, of_time: str | None
) -> None:
    sensors = (SensorColumns(*names[:3]), SensorColumns(*names[3:]))
    tables = {"actions": {names[0]: "pull"}, "trials": {"gap_s": 1.5, "keys": names}}
    columns = ColumnMap(unit, TimeColumn("t", of_time), sensors, "hand.toml", tables)
    text = columns.to_toml()
    again = column_map_of(text)
    assert (again.unit, again.time, again.sensors) == (unit, columns.time, sensors)
    assert (again.hand, again.tables) == ("hand.toml", tables)
    # the text has the keys where the lines say
    number = int(again.place_of("sensors[1].z").removeprefix("line "))
    assert text.split("\n")[number - 1] == f"z = {toml_text(names[5])}"


def test_a_message_is_flat() -> None:
    message = {"t": 1, "f": [{"x": 2.5, "ok": True}, None], "e": {}}
    assert flat_fields(message, "topic") == {
        "topic.t": 1,
        "topic.f.0.x": 2.5,
        "topic.f.0.ok": True,
        "topic.f.1": None,
    }


@pytest.mark.parametrize(
    ("line", "value", "fits"),
    [
        ("rate_hz", "0.001", True),
        ("rate_hz", "1e6", True),
        ("rate_hz", "0.00099", False),
        ("rate_hz", "1.01e6", False),
        ("rate_hz", "true", False),
        ("column", f'"{"t" * 200}"', True),
        ("column", f'"{"t" * 201}"', False),
        ("column", '""', False),
    ],
)
def test_a_rate_and_a_name_have_their_limits(line: str, value: str, fits: bool) -> None:
    text = MAP.replace('column = "millis"\nunit = "ms"', f"{line} = {value}")
    if fits:
        assert column_map_of(text).time.unit_ns == 10**9
        return
    with pytest.raises(CardError, match=rf"line 4: time\.{line}"):
        column_map_of(text)


@pytest.mark.parametrize("sensors", [0, 1, 64, 65])
def test_a_map_has_up_to_64_sensors(sensors: int) -> None:
    tables = [
        f'[[sensors]]\nx = "x{k}"\ny = "y{k}"\nz = "z{k}"\n' for k in range(sensors)
    ]
    text = 'unit = "N"\n[time]\narrival = true\n' + "".join(tables)
    if sensors in (1, 64):
        assert len(column_map_of(text).channels) == 3 * sensors
        return
    with pytest.raises(CardError, match="1 to 64 tables"):
        column_map_of(text)


def test_a_message_has_4096_fields_at_most() -> None:
    assert len(flat_fields({"a": [0] * 4096})) == 4096
    with pytest.raises(ColumnError, match="more than 4096 fields"):
        flat_fields({"a": [0] * 4097})


@pytest.mark.parametrize(
    "stamp", [2**62 - 1, -(2**62) + 1, 2**62, "4611686018427387904"]
)
def test_a_stamp_lies_within_146_years(stamp: int | str) -> None:
    columns = column_map_of(MAP.replace('unit = "ms"', 'unit = "ns"'))
    if abs(int(stamp)) < 2**62:
        assert columns.stamp_ns({"millis": stamp}, 0) == stamp
        return
    with pytest.raises(NotANumber, match="row 1, column millis: no time"):
        columns.stamp_ns({"millis": stamp}, 0)


def test_eight_columns_that_are_missing_are_named_and_the_others_counted() -> None:
    columns = column_map_of(MAP)
    with pytest.raises(
        ColumnError, match=r"no column millis \(line 4\), a\.x \(line 8\)"
    ):
        columns.require_columns([], "a")
    more = ColumnMap("N", TimeColumn(arrival=True), (SensorColumns(*"abc"),) * 3)
    with pytest.raises(ColumnError, match=r"b \(the map\) and 1 more"):
        more.require_columns([], "a")
    with pytest.raises(ColumnError) as error:
        more.require_columns([], "a", [*"abcdefgh"])
    assert "more" not in str(error.value)
