"""Lines that are samples: which are understood, and which count."""

from __future__ import annotations

import json
import math
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from holdfast.core.column_map import ColumnMap, SensorColumns, TimeColumn
from holdfast.core.errors import ColumnError
from holdfast.core.hand_lines import NOT_RISING, NOT_UNDERSTOOD, LineRefused
from holdfast.core.schema import checked, toml_of
from holdfast.core.source import SourceReading
from holdfast.drivers.lines import SAME_STAMP, SampleReader, map_of_names

NAMES = ("X1", "Y1", "Z1", "X2", "Y2", "Z2")
MS = 1_000_000

MAP = """
unit = "mN"
[time]
column = "imu.ms"
unit = "ms"
[[sensors]]
x = "f.0"
y = "-f.1"
z = "f.2"
"""


def line(value: float = 1.0, **more: Any) -> bytes:
    return json.dumps(dict.fromkeys(NAMES, value) | more).encode()


def taken(reader: SampleReader, text: bytes, at_ms: int = 0) -> SourceReading:
    sample = reader.take(text, at_ms * MS)
    assert sample is not None
    return sample


def refused(reader: SampleReader, text: bytes, at_ms: int = 0) -> str:
    with pytest.raises(LineRefused) as error:
        reader.take(text, at_ms * MS)
    return error.value.kind


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("Time,X1,Y1,Z1", "0.5,1,-2.5,3"),
        ("\ufeffTime;X1;Y1;Z1\r", "0,5;1;-2,5;3\r"),
        ("X1\tY1\tZ1\tTime", "1\t-2.5\t3\t0.5"),
        ('"Time","X1","Y1","Z1"', '0.5, 1, "-2.5", 3'),
    ],
)
def test_rows_are_read_by_their_header(header: str, row: str) -> None:
    reader = SampleReader()
    assert reader.take(header.encode(), 0) is None
    assert reader.take(b"# a comment", 0) is None
    assert reader.take(b"", 0) is None
    sample = taken(reader, row.encode())
    assert sample.values.tolist() == [1.0, -2.5, 3.0]
    assert refused(reader, row.encode()) == SAME_STAMP


def test_a_header_that_comes_again_may_have_another_order() -> None:
    reader = SampleReader()
    reader.take(b"X1,Y1,Z1", 0)
    taken(reader, b"1,2,3")
    reader.take(b"Z1,Y1,X1", 0)
    assert taken(reader, b"1,2,3").values.tolist() == [3.0, 2.0, 1.0]


def test_a_column_map_names_turns_and_scales() -> None:
    reader = SampleReader(checked(toml_of(MAP), ColumnMap, "map.toml"))
    sample = taken(reader, b'{"imu":{"ms":1500},"f":[100,200,-300]}')
    np.testing.assert_allclose(sample.values, [0.1, -0.2, -0.3])
    assert refused(reader, b'{"imu":{"ms":1499},"f":[1,2,3]}') == NOT_RISING


@pytest.mark.parametrize(
    "word",
    ["NaN", "Infinity", "-Infinity", "nan", " nan ", "-inf", "-nan(ind)", "1e999"],
)
def test_a_value_in_json_that_is_no_finite_number_is_its_sensors_loss(
    word: str,
) -> None:
    """As json.dumps, ROS and printf write them."""
    text = f'{{"f":[1,2,3,4,{word},6],"other":{word}}}'
    names = [f"f.{k}" for k in range(6)]
    first = SensorColumns(names[0], names[1], names[2])
    sensors = [first, SensorColumns(names[3], names[4], names[5])]
    time = TimeColumn(arrival=True)
    reader = SampleReader(ColumnMap(unit="N", time=time, sensors=tuple(sensors)))
    assert taken(reader, text.encode()).valid.tolist() == [True, False]


@pytest.mark.parametrize("word", ['"nan"', "null", "1".ljust(5000, "0")])
def test_a_text_null_or_a_number_without_end_is_its_sensors_loss_too(word: str) -> None:
    text = line().replace(b'"Y2": 1.0', f'"Y2": {word}'.encode())
    assert taken(SampleReader(), text).valid.tolist() == [True, False]


@pytest.mark.parametrize("cell", ["", "nan", "inf", "-inf", "1e999", "-nan(ind)"])
def test_a_cell_that_is_no_finite_number_makes_its_sensor_invalid(cell: str) -> None:
    reader = SampleReader()
    reader.take(",".join(NAMES).encode(), 0)
    assert taken(reader, f"1,2,3,4,{cell},6".encode()).valid.tolist() == [True, False]


@pytest.mark.parametrize(
    "text",
    [
        b"[1,2]",
        b"null",
        b"1",
        b"{}",
        b"[" * 2000,
        b'{"t_s":NaN,"X1":1,"Y1":1,"Z1":1}',
        b'{"sequence":NaN,"X1":1,"Y1":1,"Z1":1}',
        b'{"X1":nan nan,"Y1":1,"Z1":1}',
        b'{"X1":"a","Y1":1,"Z1":1}',
        b'{"X1":1,"Y1":1}',
        b'{"X1":1,"Y1":1,"Z1":1,"X3":1,"Y3":1,"Z3":1}',
        b'{"X9999":1}',
        b"\xff\xfe",
        b"1,2,3",
        b"Time,Time,X1,Y1,Z1",
        b"{" + b" " * 20_000 + b"}",
    ],
)
def test_what_is_no_sample_is_refused_and_the_next_line_is_read(text: bytes) -> None:
    reader = SampleReader()
    assert refused(reader, text) == NOT_UNDERSTOOD
    taken(reader, line())


def test_a_row_with_other_cells_than_its_header_is_refused() -> None:
    reader = SampleReader()
    reader.take(b"X1,Y1,Z1", 0)
    assert refused(reader, b"1,2") == NOT_UNDERSTOOD
    assert refused(reader, b"1,2,x") == NOT_UNDERSTOOD


def test_columns_of_which_none_is_a_sensor_say_what_to_do() -> None:
    with pytest.raises(ColumnError, match="map=FILE"):
        map_of_names(["a", "b"], "N")


# -- which lines count


def test_time_and_sequence_must_rise_until_the_sender_was_silent_for_300_ms() -> None:
    reader = SampleReader()
    taken(reader, line(t_ms=1000, sequence=7))
    assert refused(reader, line(t_ms=1000, sequence=8)) == SAME_STAMP
    for numbers in ({"t_ms": 999}, {"sequence": 7}, {"sequence": 0}):
        assert refused(reader, line(**({"t_ms": 1001, "sequence": 8} | numbers))) == (
            NOT_RISING
        )
    taken(reader, line(t_ms=1001, sequence=8), 300)
    assert refused(reader, line(t_ms=3, sequence=0), 600) == NOT_RISING
    taken(reader, line(t_ms=3, sequence=0), 601)


def test_lines_without_any_number_count_one_after_the_other() -> None:
    reader = SampleReader()
    for at_ms in (0, 10, 310, 611):
        taken(reader, line(), at_ms)


def test_a_line_that_is_not_understood_does_not_count() -> None:
    reader = SampleReader()
    taken(reader, line(sequence=1))
    assert refused(reader, line(sequence=9, X1="a"), 1) == NOT_UNDERSTOOD
    assert refused(reader, line(sequence=-1), 1) == NOT_UNDERSTOOD
    taken(reader, line(sequence=2), 2)


@given(
    st.lists(st.floats(allow_nan=False, allow_infinity=False), min_size=6, max_size=6)
)
def test_numbers_come_as_they_were_sent_in_both_formats(values: list[float]) -> None:
    as_object = json.dumps(dict(zip(NAMES, values, strict=True))).encode()
    assert taken(SampleReader(), as_object).values.tolist() == values
    reader = SampleReader()
    reader.take(",".join(NAMES).encode(), 0)
    row = ",".join(map(repr, values)).encode()
    assert taken(reader, row).values.tolist() == values
    assert all(map(math.isfinite, values))


def test_a_line_may_have_16_kib() -> None:
    padded = line().ljust(16 << 10, b" ")
    assert taken(SampleReader(), padded).valid.all()
    assert refused(SampleReader(), padded + b" ") == NOT_UNDERSTOOD


def test_there_may_be_12_sensors_and_as_many_as_have_all_their_columns() -> None:
    def names(n_sensors: int) -> list[str]:
        return [f"{axis}{k}" for k in range(1, n_sensors + 1) for axis in "XYZ"]

    assert len(map_of_names(names(12), "N").channels) == 36
    with pytest.raises(ColumnError, match="13 sensors, and 12 are the most"):
        map_of_names(names(13), "N")
    for wrong in (names(2)[:5], names(2)[3:], ["X0", "Y0", "Z0"]):
        with pytest.raises(ColumnError, match="no columns X1"):
            map_of_names(wrong, "N")


@pytest.mark.parametrize(
    ("name", "unit"),
    [("Time", "s"), ("t_s", "s"), ("t_ms", "ms"), ("t_us", "us"), ("t_ns", "ns")],
)
def test_a_column_of_time_has_the_unit_of_its_name(name: str, unit: str) -> None:
    time = map_of_names((*NAMES, name), "N").time
    assert (time.column, time.unit) == (name, unit)
    assert map_of_names(NAMES, "N").time.arrival


@pytest.mark.parametrize("flag", [0, "0", "false", False, 0.0, None, math.nan, ""])
def test_a_flag_that_is_zero_false_or_not_there_makes_a_sensor_invalid(
    flag: Any,
) -> None:
    assert taken(SampleReader(), line(valid1=1, valid2=flag)).valid.tolist() == [
        True,
        False,
    ]
    assert taken(SampleReader(), line(valid1=flag)).valid.tolist() == [False, True]
    # without the first flag there are none
    assert taken(SampleReader(), line(valid2=flag)).valid.all()
