"""The column map: which columns are time and sensors, for imports and for live sources alike."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from holdfast.core.column_map import ColumnMap, flat_fields, read_column_map
from holdfast.core.errors import CardError, ColumnError, NotANumber
from holdfast.core.hand_card import HANDS
from holdfast.core.schema import checked, toml_of

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


def of(text: str) -> ColumnMap:
    return checked(toml_of(text), ColumnMap, "map.toml")


def test_a_row_becomes_channels_in_the_unit_of_a_model() -> None:
    columns = of(MAP)
    assert columns.unit_of_values == "N"
    values = columns.values_of(ROW)
    np.testing.assert_allclose(values, [1, 2, -3, np.nan, np.nan, 0.0015])
    assert columns.stamp_ns(ROW) == 1_500_000_000


def test_a_reading_that_rests_far_from_0_is_turned_about_its_rest() -> None:
    mirrored = of(MAP.replace('z = "-a.z"', 'z = "-a.z"\nz_zero = 4096'))
    at_rest, pressed = ({**ROW, "a.z": cell} for cell in (2048, 1900))
    assert mirrored.values_of(at_rest)[2] == pytest.approx(2.048)
    assert mirrored.values_of(pressed)[2] == pytest.approx(2.196)


def test_a_table_becomes_the_same_as_its_rows() -> None:
    columns = of(MAP)
    table = {name: np.arange(4.0) + k for k, name in enumerate(columns.columns)}
    rows = [{name: cells[t] for name, cells in table.items()} for t in range(4)]
    by_row = [columns.values_of(row) for row in rows]
    np.testing.assert_array_equal(columns.values_of(table), by_row)
    stamps = [columns.stamp_ns(row) for row in rows]
    assert columns.stamps_ns(table, 4).tolist() == stamps


def two_axes(tmp_path: Path, card: str = "yz", text: str = MAP) -> ColumnMap:
    """The map without a column for x of its first sensor, and the card of its hand."""
    read = (HANDS / "two-pad-gripper.toml").read_text("utf-8")
    read = read.replace("[[sensors]]\n", f'[[sensors]]\nmeasures = "{card}"\n', 1)
    (tmp_path / "hand.toml").write_text(read, "utf-8")
    return of('hand = "hand.toml"\n' + text.replace('x = "a.x"\n', ""))


def test_an_axis_without_a_column_is_zero_where_the_hand_card_denies_it_too(
    tmp_path: Path,
) -> None:
    columns = two_axes(tmp_path)
    hand = columns.hand_card(tmp_path)
    assert hand is not None
    assert columns.unmeasured_names == hand.unmeasured_names == ("X1",)
    assert columns.channels == ("a.y", "a.z", "b.x", "b.y", "b.z")
    values = columns.values_of(ROW)
    np.testing.assert_allclose(values, [0, 2, -3, np.nan, np.nan, 0.0015])
    table = {name: np.arange(4.0) + k for k, name in enumerate(columns.columns)}
    assert columns.values_of(table)[:, 0].tolist() == [0.0] * 4
    assert columns.values_of(table)[1].tolist() == [
        0,
        0.002,
        -0.003,
        0.004,
        0.005,
        0.006,
    ]


def test_a_map_and_a_card_that_differ_in_what_is_measured_are_refused(
    tmp_path: Path,
) -> None:
    with pytest.raises(CardError, match="no columns for X1, and the hand card"):
        two_axes(tmp_path, "xyz").hand_card(tmp_path)
    with pytest.raises(CardError, match="columns for Y1, which the hand card"):
        two_axes(tmp_path, "xz").hand_card(tmp_path)
    with pytest.raises(CardError, match="no columns for X1, and no hand card"):
        of(MAP.replace('x = "a.x"\n', "")).hand_card(tmp_path)
    with pytest.raises(CardError, match="a field needs all three axes"):
        two_axes(tmp_path, text=MAP.replace('"mN"', '"uT"')).hand_card(tmp_path)


@pytest.mark.parametrize("stamp", [1_700_000_000_123_456_789, "1700000000123456789"])
def test_a_stamp_in_nanoseconds_keeps_its_digits(stamp: int | str) -> None:
    columns = of(MAP.replace('"ms"', '"ns"'))
    assert columns.stamp_ns({**ROW, "millis": stamp}) == int(stamp)
    table = {"millis": np.array([int(stamp)])}
    assert columns.stamps_ns(table, 1).tolist() == [int(stamp)]


@pytest.mark.parametrize(
    ("time", "stamps"),
    [
        ("rate_hz = 100", [0, 10_000_000, 20_000_000]),
        ('column = "millis"\nrate_hz = 100', [50_000_000, 60_000_000, 90_000_000]),
    ],
)
def test_rows_or_a_counter_are_a_clock_where_the_map_has_a_rate(
    time: str, stamps: list[int]
) -> None:
    columns = of(MAP.replace('column = "millis"\nunit = "ms"', time))
    table = {"millis": np.array([5, 6, 9])}
    assert columns.stamps_ns(table, 3).tolist() == stamps


def test_a_file_has_no_times_of_arrival_and_a_sender_does() -> None:
    columns = of(MAP.replace('column = "millis"\nunit = "ms"', "arrival = true"))
    assert columns.stamp_ns(ROW) is None
    with pytest.raises(ColumnError, match="a file has no times of arrival"):
        columns.stamps_ns({}, 3)


@pytest.mark.parametrize(
    ("old", "new", "what"),
    [
        ('unit = "mN"', 'unit = "kg"', "unit = 'kg'; next: allowed: N or mN or cN"),
        ('unit = "ms"', 'unit = "min"', "time.unit = 'min'"),
        ('z = "-a.z"', "z = 3", r"sensors\[0\].z = 3"),
        ('z = "-a.z"', "", r"sensors\[0\]: z is missing"),
        ('z = "b.z"', 'z = "a.z"', "'a.z' stands twice"),
        ('z = "b.z"', 'z = "b.z"\nw = "q"', r"sensors\[1\].w is not known"),
        ('column = "millis"', "arrival = true", "a unit without its column"),
        ('column = "millis"\nunit = "ms"', "", "one of column, rate_hz and arrival"),
        ('column = "millis"\nunit = "ms"', "rate_hz = 1e7", "time.rate_hz"),
        ("[time]", "[times]", "times is not known"),
        ('unit = "mN"', 'unit = "mN', "not valid TOML"),
    ],
)
def test_an_error_names_the_file_and_the_key(
    tmp_path: Path, old: str, new: str, what: str
) -> None:
    path = tmp_path / "lab.toml"
    assert old in MAP
    path.write_text(MAP.replace(old, new, 1), encoding="utf-8")
    with pytest.raises(CardError, match=what) as error:
        read_column_map(path)
    assert error.value.where == str(path)


def test_columns_that_are_not_there_are_named() -> None:
    with pytest.raises(ColumnError, match=r"no column a\.y, b\.z"):
        of(MAP).values_of({"millis": 0, "a.x": 1, "a.z": 1, "b.x": 1, "b.y": 1})


def test_text_in_a_column_of_numbers_is_refused() -> None:
    with pytest.raises(NotANumber, match=r"column a\.x: '1,5' is no number"):
        of(MAP).values_of({**ROW, "a.x": "1,5"})


def test_a_hand_card_of_other_sensors_is_refused(tmp_path: Path) -> None:
    two = f'hand = "two-pad-gripper"\n{MAP}'
    hand = of(two).hand_card(tmp_path)
    assert hand is not None
    assert hand.n_sensors == 2
    one = of(two.rpartition("[[sensors]]")[0])
    with pytest.raises(CardError, match="the hand two-pad-gripper has 2 sensors"):
        one.hand_card(tmp_path)


def test_the_tables_of_an_import_are_left_to_it() -> None:
    text = MAP + '\n[trials]\npath = "{person}/{n}.csv"\n'
    assert of(text).trials == {"path": "{person}/{n}.csv"}


def test_a_message_is_flat_and_has_4096_fields_at_most() -> None:
    message = {"t": 1, "f": [{"x": 2.5, "ok": True}, None], "e": {}}
    assert flat_fields(message, "topic") == {
        "topic.t": 1,
        "topic.f.0.x": 2.5,
        "topic.f.0.ok": True,
        "topic.f.1": None,
    }
    with pytest.raises(ColumnError, match="more than 4096 fields"):
        flat_fields({"a": [0] * 4097})


@pytest.mark.parametrize("stamp", [2**62 - 512, 2**62, "4611686018427387904"])
def test_a_stamp_lies_within_146_years(stamp: int | str) -> None:
    columns = of(MAP.replace('unit = "ms"', 'unit = "ns"'))
    if int(stamp) < 2**62:
        assert columns.stamp_ns({"millis": stamp}) == stamp
        return
    with pytest.raises(NotANumber, match="row 1, column millis: no time"):
        columns.stamp_ns({"millis": stamp})
