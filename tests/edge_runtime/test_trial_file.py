"""One trial as a CSV file: what is read, and how each kind of damage is refused."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from holdfast.core.errors import (
    ColumnError,
    DataError,
    DataNotFound,
    EmptyRecording,
    NotANumber,
    TimeError,
)
from holdfast.core.trial_file import implausible_rate, read_trial

HEADER = "Time,X1,Y1,Z1,X2,Y2,Z2"


def rows(times_s: list[float] | None = None) -> list[str]:
    return [
        f"{t_s:.3f},1,2,3,4,5,6" for t_s in times_s or [0.0, 0.02, 0.04, 0.06, 0.08]
    ]


def written(
    tmp_path: Path, header: str = HEADER, lines: list[str] | None = None
) -> Path:
    path = tmp_path / "trial_1.csv"
    path.write_text(
        "\n".join([header, *(rows() if lines is None else lines)]) + "\n",
        encoding="utf-8",
    )
    return path


def test_a_trial_is_time_from_zero_channels_and_validity(tmp_path: Path) -> None:
    trial = read_trial(written(tmp_path, lines=rows([10.0, 10.02, 10.04, 10.06])))
    np.testing.assert_allclose(trial.t_s, [0.0, 0.02, 0.04, 0.06], atol=1e-9)
    np.testing.assert_array_equal(trial.raw, np.tile([1, 2, 3, 4, 5, 6], (4, 1)))
    assert trial.valid.shape == (4, 2)
    assert trial.valid.all()
    assert trial.rate_hz == pytest.approx(50.0)


def test_the_rate_is_the_median_step_so_one_late_sample_does_not_move_it(
    tmp_path: Path,
) -> None:
    assert read_trial(
        written(tmp_path, lines=rows([0, 0.02, 0.04, 0.09, 0.11, 0.13]))
    ).rate_hz == pytest.approx(50.0)


def test_the_recorders_own_columns_are_read_and_its_validity_is_kept(
    tmp_path: Path,
) -> None:
    lines = [f"{line},{k},{k},{k},1,{int(k != 2)}" for k, line in enumerate(rows())]
    trial = read_trial(
        written(tmp_path, f"{HEADER},host_ns,device_us,sequence,valid1,valid2", lines)
    )
    assert trial.raw.shape == (5, 6)
    assert np.argwhere(~trial.valid).tolist() == [[2, 1]]


def test_a_byte_order_mark_and_windows_line_ends_are_accepted(tmp_path: Path) -> None:
    path = tmp_path / "trial_1.csv"
    path.write_bytes(
        b"\xef\xbb\xbf" + "\r\n".join([HEADER, *rows()]).encode() + b"\r\n"
    )
    assert read_trial(path).raw.shape == (5, 6)


@given(
    values=st.lists(
        st.lists(st.floats(allow_infinity=False, width=64), min_size=3, max_size=3),
        min_size=2,
    )
)
@settings(max_examples=50)
def test_what_is_written_is_read_back_to_the_last_bit(
    tmp_path_factory: pytest.TempPathFactory, values: list[list[float]]
) -> None:
    lines = [",".join([f"{k}", *map(repr, row)]) for k, row in enumerate(values)]
    path = written(tmp_path_factory.mktemp("exact"), "Time,X1,Y1,Z1", lines)
    np.testing.assert_array_equal(read_trial(path).raw, values)


def changed(line: int, text: str) -> list[str]:
    lines = rows()
    lines[line] = text
    return lines


REFUSED = {
    "a column is missing": (
        "Time,X1,Y1,Z1,X2,Y2",
        ["0,1,2,3,4,5", "1,1,2,3,4,5"],
        ColumnError,
        "Z2",
    ),
    "there is no channel": ("Time", ["0", "1"], ColumnError, "X1"),
    "there is no time": ("X1,Y1,Z1,X2,Y2,Z2,Q", None, ColumnError, "Time"),
    "a column is unknown": (f"{HEADER},Temperature", None, ColumnError, "Temperature"),
    "a column occurs twice": (
        "Time,X1,Y1,Z1,X2,Y2,Z2,valid1,valid1",
        ["0,1,2,3,4,5,6,1,1", "1,1,2,3,4,5,6,1,1"],
        ColumnError,
        "twice",
    ),
    "channels are out of order": ("Time,Y1,X1,Z1,X2,Y2,Z2", None, ColumnError, "order"),
    "there is text in a number": (
        HEADER,
        changed(2, "0.04,1,2,oops,4,5,6"),
        NotANumber,
        "line 4, column Z1: 'oops'",
    ),
    "a cell is empty": (
        HEADER,
        changed(2, "0.04,1,,3,4,5,6"),
        NotANumber,
        "line 4, column Y1",
    ),
    "a row is short": (
        HEADER,
        changed(4, "0.08,1,2"),
        ColumnError,
        "line 6 has 3 cells",
    ),
    "a row is long": (
        HEADER,
        changed(1, "0.02,1,2,3,4,5,6,7"),
        ColumnError,
        "line 3 has 8 cells",
    ),
    "time runs backwards": (
        HEADER,
        rows([0, 0.02, 0.04, 0.03, 0.05]),
        TimeError,
        "line 5: time runs backwards",
    ),
    "time stands still": (
        HEADER,
        rows([0, 0.02, 0.02, 0.04]),
        TimeError,
        "line 4: time stands still",
    ),
    "a clock ticks too seldom": (
        HEADER,
        rows([0, 0, 0.02, 0.02, 0.04, 0.04]),
        TimeError,
        "time stands still, as in 3 lines; likely cause: its clock ticks too seldom",
    ),
    "time has a gap of days": (
        HEADER,
        rows([0, 0.02, 0.04, 2e5, 2e5 + 0.02]),
        TimeError,
        "a gap of 200000 s after 3 rows",
    ),
    "time is not finite": (HEADER, changed(3, "inf,1,2,3,4,5,6"), TimeError, "line 5"),
    "there is a header only": (HEADER, [], EmptyRecording, "0 rows"),
}


@pytest.mark.hard_case(
    "What comes from outside",
    "a trial file that is damaged",
    elsewhere="rows are dropped or filled in silently",
    here="refused in one line that names the file, the line and the column",
)
@pytest.mark.parametrize("fault", REFUSED)
def test_a_damaged_trial_file_is_refused(tmp_path: Path, fault: str) -> None:
    header, lines, error, names = REFUSED[fault]
    refuses(written(tmp_path, header, lines), error, names)


@pytest.mark.parametrize(
    "content",
    [
        bytes(range(256)) * 40,
        HEADER.encode() + b"\n\xff\xfe\x00\x01\n\x00\n",
    ],
)
def test_a_binary_file_is_refused(tmp_path: Path, content: bytes) -> None:
    path = tmp_path / "trial_1.csv"
    path.write_bytes(content)
    with pytest.raises((NotANumber, ColumnError)) as caught:
        read_trial(path)
    one_line_that_names(path, caught.value)


def test_a_file_that_is_absent_and_a_folder_have_different_errors(
    tmp_path: Path,
) -> None:
    refuses(tmp_path / "nowhere.csv", DataNotFound, "no such file")
    refuses(tmp_path, NotANumber, "folder")


def refuses(path: Path, error: type[DataError], names: str) -> None:
    with pytest.raises(error) as caught:
        read_trial(path)
    assert type(caught.value) is error
    assert names in str(caught.value)
    one_line_that_names(path, caught.value)


def one_line_that_names(path: Path, error: DataError) -> None:
    assert str(error).startswith(f"{path}: ")
    assert "\n" not in str(error)
    assert error.next_step


def test_rows_lost_in_a_short_gap_come_back_as_invalid_rows(tmp_path: Path) -> None:
    trial = read_trial(written(tmp_path, lines=rows([0.0, 0.02, 0.04, 0.10, 0.12])))
    np.testing.assert_allclose(trial.t_s, 0.02 * np.arange(7), atol=1e-12)
    for lost in (~trial.valid, np.isnan(trial.raw)):
        assert np.flatnonzero(lost.all(axis=1)).tolist() == [3, 4]
        assert np.flatnonzero(lost.any(axis=1)).tolist() == [3, 4]


def test_time_may_be_in_a_column_that_names_its_unit(tmp_path: Path) -> None:
    header = HEADER.replace("Time", "t_ms")
    trial = read_trial(written(tmp_path, header, rows([5, 25, 45])))
    np.testing.assert_allclose(trial.t_s, [0.0, 0.02, 0.04])


def test_rows_are_times_to_the_end_of_a_long_trial_though_its_stamps_are_rounded(
    tmp_path: Path,
) -> None:
    """At 300 Hz a step written to the microsecond is off by 1e-4 of itself: 20 ms after three
    minutes."""
    path = tmp_path / "trial_1.csv"
    rows = [f"{k / 300:.6f},0,0,1" for k in range(300 * 180)]
    path.write_text("\n".join(["Time,X1,Y1,Z1", *rows]) + "\n", encoding="utf-8")
    trial = read_trial(path)
    assert abs((len(trial.t_s) - 1) / trial.rate_hz - trial.t_s[-1]) < 1e-4
    assert abs(trial.rate_hz - 300.0) < 1e-4


@pytest.mark.parametrize(
    ("rate_hz", "says"),
    [
        (5.0, ""),
        (5000.0, ""),
        (4.99, "runs at 4.99 Hz: looks like milliseconds (4990 Hz)"),
        (1e-4, "looks like microseconds (100 Hz)"),
        (6000.0, "runs at 6000 Hz: looks like minutes (100 Hz)"),
        (1e9, "runs at 1e+09 Hz: no time in seconds"),
    ],
)
def test_a_rate_that_no_hand_has_says_what_its_time_may_be_in(
    rate_hz: float, says: str
) -> None:
    found = implausible_rate(rate_hz)
    assert found.endswith(says)
    assert bool(found) == bool(says)


def test_rows_that_the_counter_skips_are_lost(tmp_path: Path) -> None:
    header = f"{HEADER},sequence"

    def read(*counted: float) -> list[bool]:
        lines = [f"{0.02 * k:.3f},1,2,3,4,5,6,{n}" for k, n in enumerate(counted)]
        return read_trial(written(tmp_path, header, lines)).valid[:, 0].tolist()

    assert read(7, 8, 10, 13) == [True, True, False, True, False, False, True]
    assert read(3, 4, 6, 10) == [True, True, False, True, False, False, False, True]
    assert sum(read(3, 4, 6, 100)) == 4
    for wrong in (
        (3, 4, 4),
        (3, 4, 4.5),
        (3, 2, 5),
        (3, float("nan"), 5),
        (1, 2, 1e12),
    ):
        with pytest.raises(TimeError, match="does not count up"):
            read(*wrong)
