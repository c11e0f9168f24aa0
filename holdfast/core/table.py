"""A table of numbers as CSV bytes, many times faster than formatting them one by one.

Neighbouring columns with the same number of decimals are formatted together. Every cell is scaled,
rounded half to even, and divided by ten for each digit. Cells shorter than the longest of their
columns get blanks, which are removed from the whole at the end.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from itertools import groupby

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray, channel_names
from holdfast.core.trial_file import TIME_COLUMN

Column = tuple[FloatArray, int]
"""Values [T] of a column, and the decimals with which they are written."""
Letters = npt.NDArray[np.uint8]
"""Bytes of text, one number a letter."""
LARGEST = 2**53
"""Up to here float64 holds every whole number."""
BLANK, MINUS, POINT, COMMA, NEWLINE, ZERO = b" -.,\n0"
NAN = np.frombuffer(b"nan", dtype=np.uint8)


def csv_bytes(header: Sequence[str], columns: Sequence[Column]) -> bytes:
    """Header and rows; columns: (values [T], decimals). nan is written as such.

    A cell is the decimal nearest to value * 10^decimals in float64, ties to even. Raises ValueError
    for infinite values and for those with more digits than float64 has.
    """
    head = ",".join(header).encode() + b"\n"
    rows = len(columns[0][0])
    if not rows:
        return head

    parts = []
    for decimals, alike in groupby(columns, key=lambda column: column[1]):
        arrays = [np.asarray(column[0], np.float64) for column in alike]
        values = np.stack(arrays, 1)
        cells = _cells(values, decimals)
        parts.append(cells.reshape(rows, -1))

    # The comma after the last column ends the row instead.
    parts[-1][:, -1] = NEWLINE
    padded = np.hstack(parts).tobytes()
    return head + padded.translate(None, b" ")


def trial_csv(
    t_s: FloatArray,
    values: FloatArray,
    time_decimals: int,
    decimals: int,
    absent: Collection[str] = (),
) -> bytes:
    """A trial file: times [T] and values [T, C]; absent: channels that are not measured.

    Raises ValueError as `csv_bytes` does.
    """
    header, columns = [TIME_COLUMN], [(t_s, time_decimals)]
    names = channel_names(values.shape[1] // 3)
    for name, channel in zip(names, values.T, strict=True):
        if name not in absent:
            header.append(name)
            columns.append((channel, decimals))
    return csv_bytes(header, columns)


def _cells(values: FloatArray, decimals: int) -> Letters:
    """[T, K] numbers -> [T, K, width] letters, a comma at the end."""
    lost = np.isnan(values)
    known = np.where(lost, 0.0, values) if lost.any() else values

    # A larger number would be rounded by float64 before it is rounded to its decimals.
    bound = LARGEST / 10.0**decimals
    if not (np.abs(known) < bound).all():
        raise ValueError("a value is infinite or has more digits than float64 holds")

    scaled = np.rint(known * 10.0**decimals)
    left = np.abs(scaled)
    digits = max(len(str(int(left.max()))), decimals + 1, len(NAN))
    # numbers of 32 bits divide faster
    left = left.astype(np.uint32 if left.max() < 2**32 else np.uint64)
    ten = left.dtype.type(10)

    # sign, digits, point, comma
    width = 1 + digits + (decimals > 0) + 1
    letters = np.full((*values.shape, width), BLANK, dtype=np.uint8)
    # a value that rounds to zero gets no sign, because -0.0 is not below zero
    letters[scaled < 0.0, 0] = MINUS
    letters[..., -1] = COMMA
    if decimals:
        letters[..., -2 - decimals] = POINT

    # from the last digit to the first; blanks before it, but one digit before the point
    for k in range(digits):
        above = left // ten
        digit = (left - ten * above).astype(np.uint8) + ZERO
        if k > decimals:
            digit[left == 0] = BLANK
        letters[..., -2 - k - (0 < decimals <= k)] = digit
        left = above

    # a missing value was written as 0 so far
    if lost.any():
        letters[lost, :-1] = BLANK
        letters[lost, -1 - len(NAN) : -1] = NAN

    return letters
