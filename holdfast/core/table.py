"""A table of numbers as CSV bytes, many times faster than formatting them one by one.

Neighbouring columns with the same number of decimals are formatted together. Every cell is scaled,
rounded half to even, and divided into groups of four digits, whose letters a table holds. Cells
shorter than the longest of their columns get blanks, which are removed from the whole at the end.
"""

from __future__ import annotations

from collections.abc import Sequence
from functools import cache
from itertools import groupby
from typing import Any

import numpy as np
import numpy.typing as npt

from holdfast.core.contract import FloatArray

Column = tuple[FloatArray, int]
"""Values [T] of a column, and the decimals with which they are written."""
Letters = npt.NDArray[np.uint8]
"""Bytes of text, one number a letter."""
Whole = npt.NDArray[np.unsignedinteger[Any]]
"""Whole numbers without a sign, of 32 or 64 bits."""
LARGEST = 2**53
"""Up to here float64 holds every whole number."""
GROUP = 4
"""Digits of one table entry: four letters are one uint32."""
BLANK, MINUS, POINT, COMMA, NEWLINE = (ord(letter) for letter in " -.,\n")
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

    # Every cell of the block is as wide as its longest, or as "nan".
    most = left.max()
    longest = len(str(int(most)))
    before_point = max(longest - decimals, len(NAN) - 1)
    # Sign, digits, point, decimals, comma.
    width = 1 + before_point + (decimals > 0) + decimals + 1
    letters = np.empty((*values.shape, width), dtype=np.uint8)

    # A value that rounds to zero gets no sign, because -0.0 is not below zero.
    letters[..., 0] = np.where(scaled < 0.0, MINUS, BLANK)
    letters[..., -1] = COMMA

    # Numbers of 32 bits divide faster.
    kind = np.uint32 if most < 2**32 else np.uint64
    digits: Whole = left.astype(kind)
    whole = _write_decimals(digits, letters[..., 1:-1], decimals)
    _write_whole(whole, letters[..., 1 : 1 + before_point])
    # A missing value was written as 0 so far.
    if lost.any():
        letters[lost, :-1] = BLANK
        letters[lost, -1 - len(NAN) : -1] = NAN

    return letters


def _write_decimals(left: Whole, letters: Letters, decimals: int) -> Whole:
    """Write the last digits of whole numbers [T, K] with the point; returns the digits before."""
    place = letters.shape[-1] - decimals

    # From the last group to the first: a division takes the digits off at the end.
    for end in range(decimals, 0, -GROUP):
        start = max(end - GROUP, 0)
        width = end - start
        left, group = _split(left, width)
        digits = _letters_of(_groups("0"), group, width)
        letters[..., place + start : place + end] = digits

    if decimals:
        letters[..., -1 - decimals] = POINT
    return left


def _write_whole(left: Whole, letters: Letters) -> None:
    """Write whole numbers [T, K] right-aligned, with blanks in front and at least one digit."""
    before_point = letters.shape[-1]

    for end in range(before_point, 0, -GROUP):
        start = max(end - GROUP, 0)
        width = end - start
        places = letters[..., start:end]
        whole = left
        left, group = _split(left, width)

        # As if this group were the first of its number: blanks in front.
        places[...] = _letters_of(_groups(""), group, width)

        # The number ended in the group behind this one.
        if end < before_point:
            places[whole == 0] = BLANK

        # A number with more digits in front has zeros instead of the blanks.
        if start:
            full = left > 0
            places[full] = _letters_of(_groups("0"), group[full], width)


def _split(left: Whole, digits: int) -> tuple[Whole, Whole]:
    """(the digits in front, the last ones)."""
    # Of the array's own type, because a larger one would make the division slow.
    ten = left.dtype.type(10**digits)
    above = left // ten
    last = left - above * ten
    return above, last


def _letters_of(table: npt.NDArray[np.uint32], group: Whole, width: int) -> Letters:
    """[..] -> [.., width] the last letters of each group."""
    # An entry of the table is four letters in one number.
    entries = table[group]
    letters = entries.view(np.uint8).reshape(*group.shape, GROUP)
    return letters[..., GROUP - width :]


@cache
def _groups(fill: str) -> npt.NDArray[np.uint32]:
    """Every group of digits as four letters, filled up in front."""
    layout = f"{fill}{GROUP}"
    words = [format(n, layout) for n in range(10**GROUP)]
    letters = "".join(words).encode()
    return np.frombuffer(letters, dtype=np.uint32)
