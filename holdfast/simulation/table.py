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
Letters = npt.NDArray[np.uint8]
Whole = npt.NDArray[np.unsignedinteger[Any]]
LARGEST = 2**53
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
    if not len(columns[0][0]):
        return head
    parts = []
    for decimals, alike in groupby(columns, key=lambda column: column[1]):
        cells = _cells(
            np.stack(
                [np.asarray(values, dtype=np.float64) for values, _ in alike], axis=1
            ),
            decimals,
        )
        parts.append(cells.reshape(len(cells), -1))
    parts[-1][:, -1] = NEWLINE
    return head + np.hstack(parts).tobytes().translate(None, b" ")


def _cells(values: FloatArray, decimals: int) -> Letters:
    """[T, K] numbers -> [T, K, width] letters, a comma at the end."""
    lost = np.isnan(values)
    known = np.where(lost, 0.0, values) if lost.any() else values
    if not (np.abs(known) < LARGEST / 10.0**decimals).all():
        raise ValueError("a value is infinite or has more digits than float64 holds")
    scaled = np.rint(known * 10.0**decimals)
    left = np.abs(scaled)
    before_point = max(len(str(int(left.max()))) - decimals, len(NAN) - 1)
    letters = np.empty(
        (*values.shape, 1 + before_point + (decimals > 0) + decimals + 1),
        dtype=np.uint8,
    )
    letters[..., 0] = np.where(scaled < 0.0, MINUS, BLANK)
    letters[..., -1] = COMMA
    rest = _write_decimals(
        left.astype(np.uint32 if left.max() < 2**32 else np.uint64),
        letters[..., 1:-1],
        decimals,
    )
    _write_whole(rest, letters[..., 1 : 1 + before_point])
    if lost.any():
        letters[lost, :-1] = BLANK
        letters[lost, -1 - len(NAN) : -1] = NAN
    return letters


def _write_decimals(left: Whole, letters: Letters, decimals: int) -> Whole:
    """Write the last digits of whole numbers [T, K] with the point; returns the digits before."""
    for end in range(decimals, 0, -GROUP):
        start = max(end - GROUP, 0)
        left, group = _split(left, end - start)
        place = letters.shape[-1] - decimals
        letters[..., place + start : place + end] = _letters_of(
            _zeros_in_front(), group, end - start
        )
    if decimals:
        letters[..., -1 - decimals] = POINT
    return left


def _write_whole(left: Whole, letters: Letters) -> None:
    """Write whole numbers [T, K] right-aligned, with blanks in front and at least one digit."""
    for end in range(letters.shape[-1], 0, -GROUP):
        start = max(end - GROUP, 0)
        is_last, whole = end == letters.shape[-1], left
        left, group = _split(left, end - start)
        letters[..., start:end] = _letters_of(_blanks_in_front(), group, end - start)
        if not is_last:
            letters[..., start:end][whole == 0] = BLANK
        if start:
            full = left > 0
            letters[..., start:end][full] = _letters_of(
                _zeros_in_front(), group[full], end - start
            )


def _split(left: Whole, digits: int) -> tuple[Whole, Whole]:
    """(the digits in front, the last ones)."""
    ten = left.dtype.type(10**digits)
    above = left // ten
    return above, left - above * ten


def _letters_of(table: npt.NDArray[np.uint32], group: Whole, width: int) -> Letters:
    """[..] -> [.., width] the last letters of each group."""
    return (
        table[group].view(np.uint8).reshape(*group.shape, GROUP)[..., GROUP - width :]
    )


@cache
def _zeros_in_front() -> npt.NDArray[np.uint32]:
    return np.frombuffer(
        "".join(f"{n:0{GROUP}d}" for n in range(10**GROUP)).encode(), dtype=np.uint32
    )


@cache
def _blanks_in_front() -> npt.NDArray[np.uint32]:
    return np.frombuffer(
        "".join(f"{n:{GROUP}d}" for n in range(10**GROUP)).encode(), dtype=np.uint32
    )
