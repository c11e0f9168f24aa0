"""The same formulas for one hand and for a batch: a number is a float, or an array [B] of floats.

What a grip controller computes is a few dozen operations on single numbers. On the hand they run on
Python's own floats, which is several times faster than numpy on arrays of one element. A closed
loop in simulation runs them on arrays of B hands. Only +, -, *, /, square roots, comparisons and
the choices below are used. IEEE 754 defines each of them to the last bit, so both give the same
bits.
"""

from __future__ import annotations

import math
from typing import Any

import numpy as np

Number = Any
"""A float, or an array [B] of float64."""
Flag = Any
"""A bool, or an array [B] of bool."""


class Batch:
    """The choices that Python and numpy write differently; here for one hand."""

    @staticmethod
    def choose(where: Flag, then: Number, otherwise: Number) -> Number:
        """`then` where the flag is set."""
        return then if where else otherwise

    @staticmethod
    def least(a: Number, b: Number) -> Number:
        return a if a < b else b

    @staticmethod
    def most(a: Number, b: Number) -> Number:
        return a if a > b else b

    @staticmethod
    def span(numbers: list[Number]) -> tuple[Number, Number]:
        """The smallest and the largest of several, none of them NaN."""
        return min(numbers), max(numbers)

    @staticmethod
    def no(flag: Flag) -> Flag:
        return not flag

    @staticmethod
    def within(low: Number, x: Number, high: Number) -> Number:
        """x, not below low and not above high."""
        x = x if x > low else low
        return x if x < high else high

    @staticmethod
    def root(x: Number) -> Number:
        """The square root of a number from 0 on."""
        return math.sqrt(x)

    @staticmethod
    def every(flags: list[Flag]) -> bool:
        """Whether all of several flags are set, in every hand."""
        return all(flags)

    def zero(self) -> Number:
        return 0.0

    def false(self) -> Flag:
        return False


class ManyHands(Batch):
    """Hands side by side: numbers and flags are arrays [B]."""

    def __init__(self, n_hands: int) -> None:
        self.n_hands = n_hands

    @staticmethod
    def choose(where: Flag, then: Number, otherwise: Number) -> Number:
        """`then` where the flag is set."""
        return np.where(where, then, otherwise)

    @staticmethod
    def no(flag: Flag) -> Flag:
        return np.logical_not(flag)

    @staticmethod
    def span(numbers: list[Number]) -> tuple[Number, Number]:
        """The smallest and the largest of several, none of them NaN."""
        return np.minimum.reduce(numbers), np.maximum.reduce(numbers)

    @staticmethod
    def least(a: Number, b: Number) -> Number:
        # not np.minimum: where one of them is NaN, Python's comparison gives b
        return np.where(a < b, a, b)

    @staticmethod
    def most(a: Number, b: Number) -> Number:
        return np.where(a > b, a, b)

    @staticmethod
    def within(low: Number, x: Number, high: Number) -> Number:
        """x, not below low and not above high."""
        x = np.where(x > low, x, low)
        return np.where(x < high, x, high)

    @staticmethod
    def root(x: Number) -> Number:
        """The square root of a number from 0 on."""
        return np.sqrt(x)

    @staticmethod
    def every(flags: list[Flag]) -> bool:
        """Whether all of several flags are set, in every hand."""
        return all(bool(flag.all()) for flag in flags)

    def zero(self) -> Number:
        return np.zeros(self.n_hands)

    def false(self) -> Flag:
        return np.zeros(self.n_hands, dtype=np.bool_)


ONE_HAND = Batch()
