"""The same formulas for one hand and for many: a number is a float, or an array [B] of floats.

What a grip controller computes is a few dozen operations on single numbers. On the hand they run on
Python's own floats, which is several times faster than numpy on arrays of one element. A closed
loop in simulation runs them on arrays of B hands. Only +, -, *, /, comparisons and the choices
below are used. IEEE 754 defines each of them to the last bit, so both give the same
bits.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

Number = Any
"""A float, or an array [B] of float64."""
Flag = Any
"""A bool, or an array [B] of bool."""


class Lanes(Protocol):
    """The choices that Python and numpy write differently."""

    def choose(self, where: Flag, then: Number, otherwise: Number) -> Number:
        """`then` where the flag is set."""
        ...

    def least(self, a: Number, b: Number) -> Number:
        """The smaller of two."""
        ...

    def most(self, a: Number, b: Number) -> Number:
        """The larger of two."""
        ...

    def within(self, low: Number, x: Number, high: Number) -> Number:
        """x, not below low and not above high."""
        ...

    def no(self, flag: Flag) -> Flag:
        """Not."""
        ...

    def zero(self) -> Number:
        """0 for every hand."""
        ...

    def false(self) -> Flag:
        """False for every hand."""
        ...


class OneLane:
    """One hand: Python's floats and bools."""

    @staticmethod
    def choose(where: Flag, then: Number, otherwise: Number) -> Number:
        """`then` where the flag is set."""
        return then if where else otherwise

    @staticmethod
    def least(a: Number, b: Number) -> Number:
        """The smaller of two."""
        return a if a < b else b

    @staticmethod
    def most(a: Number, b: Number) -> Number:
        """The larger of two."""
        return a if a > b else b

    @staticmethod
    def within(low: Number, x: Number, high: Number) -> Number:
        """x, not below low and not above high."""
        x = x if x > low else low
        return x if x < high else high

    @staticmethod
    def no(flag: Flag) -> Flag:
        """Not."""
        return not flag

    @staticmethod
    def zero() -> Number:
        """0."""
        return 0.0

    @staticmethod
    def false() -> Flag:
        """False."""
        return False


class ManyLanes:
    """B hands: arrays [B]."""

    def __init__(self, batch: int) -> None:
        self.batch = batch

    choose = staticmethod(np.where)

    @staticmethod
    def least(a: Number, b: Number) -> Number:
        """The smaller of two."""
        return np.where(a < b, a, b)

    @staticmethod
    def most(a: Number, b: Number) -> Number:
        """The larger of two."""
        return np.where(a > b, a, b)

    @staticmethod
    def within(low: Number, x: Number, high: Number) -> Number:
        """x, not below low and not above high."""
        x = np.where(x > low, x, low)
        return np.where(x < high, x, high)

    no = staticmethod(np.logical_not)

    def zero(self) -> Number:
        """Zeros."""
        return np.zeros(self.batch)

    def false(self) -> Flag:
        """No flag set."""
        return np.zeros(self.batch, dtype=np.bool_)


ONE_LANE = OneLane()
