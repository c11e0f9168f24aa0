"""More than one brush element a contact: slip begins at the rim while the middle still holds."""

from __future__ import annotations

import numpy as np

from edge_runtime.contract import FloatArray
from simulation.effect import Effect
from simulation.values import Parameter


def pressure(count: int) -> FloatArray:
    """[E] share of the normal force each of E elements bears: p ~ 1 - x^2 over the patch, summing
    to one.

    A soft fingertip presses hardest in the middle (Johnson, "Contact mechanics", 1985, chapter 4),
    so the outer elements reach mu N first: incipient slip. One element bears everything and slips
    all at once.
    """
    x = (np.arange(count) + 0.5) / count
    share = 1.0 - x * x
    even: FloatArray = share / share.sum()
    return even


BRUSH = Effect(
    "brush",
    "physics",
    make=pressure,
    parameters={"count": Parameter(5.0, "", 1, 50, "elements of each contact")},
)
