"""A table of numbers as CSV: the bytes Python would write itself, and an error where it cannot."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, example, given
from hypothesis import strategies as st

from holdfast.core.contract import FloatArray
from holdfast.core.table import csv_bytes

DECIMALS = st.integers(0, 6)
WHOLE = st.integers(-(10**9), 10**9)


def column(*values: float) -> FloatArray:
    return np.array(values, dtype=np.float64)


def cells(values: FloatArray, decimals: int) -> list[str]:
    """The lines of a table of one column, without its header."""
    return csv_bytes(["a"], [(values, decimals)]).decode().split("\n")[1:-1]


def formatted(value: float, decimals: int) -> str:
    """Python's own; a zero has no sign."""
    text = f"{value:.{decimals}f}"
    return text.lstrip("-") if float(text) == 0.0 else text


def clear_of_a_tie(value: float, decimals: int) -> bool:
    """Whether value * 10^decimals rounds the same way however it is computed."""
    return abs(abs(math.fmod(value * 10.0**decimals, 1.0)) - 0.5) > 0.05


@given(DECIMALS, st.lists(st.floats(-1e7, 1e7), min_size=1, max_size=20))
@example(4, [0.0, -0.0, -0.00001, -0.00006, 0.00006, 0.99996, 9.99999, 1e8, -1e8])
def test_a_cell_has_as_many_decimals_as_its_column_says(
    decimals: int, values: list[float]
) -> None:
    assume(all(clear_of_a_tie(value, decimals) for value in values))
    assert cells(column(*values), decimals) == [
        formatted(value, decimals) for value in values
    ]


@given(DECIMALS, WHOLE.map(lambda number: number / 8.0))
def test_an_exact_tie_goes_to_the_even_digit_as_in_python(
    decimals: int, value: float
) -> None:
    assert cells(column(value), decimals) == [formatted(value, decimals)]


@pytest.mark.parametrize("decimals", [0, 1, 3, 4, 6])
def test_a_missing_value_is_nan_and_leaves_its_neighbours_alone(decimals: int) -> None:
    values = column(-1234.0, math.nan, 7.0, -math.nan)
    assert cells(values, decimals) == [
        f"{-1234.0:.{decimals}f}",
        "nan",
        f"{7.0:.{decimals}f}",
        "nan",
    ]


@pytest.mark.parametrize(
    "whole", [2**31 - 1, 2**31, 2**32 - 1, 2**32, 10**15, 2**53 - 1]
)
def test_every_digit_of_a_large_number_is_written(whole: int) -> None:
    assert cells(column(whole, -whole, 1.0), 0) == [str(whole), str(-whole), "1"]


@pytest.mark.parametrize(
    ("value", "decimals"),
    [
        (math.inf, 4),
        (-math.inf, 4),
        (2.0**53, 0),
        (-(2.0**53), 0),
        (2.0**53 / 1e4, 4),
        (1e300, 4),
    ],
)
def test_a_value_that_no_cell_can_hold_is_an_error(value: float, decimals: int) -> None:
    with pytest.raises(ValueError, match="infinite or has more digits"):
        csv_bytes(["a"], [(column(1.0, value), decimals)])


def test_header_rows_and_line_ends_are_those_of_a_csv_file() -> None:
    table = csv_bytes(
        ["Time", "a long name", "n"],
        [(column(0.0, 0.01), 6), (column(-1.5, 20.25), 1), (column(1.0, math.nan), 0)],
    )
    assert table == b"Time,a long name,n\n0.000000,-1.5,1\n0.010000,20.2,nan\n"
