"""Several brush elements a contact: slip begins at the rim while the middle still holds."""

from __future__ import annotations

import numpy as np

from holdfast.edge_runtime.contract import FloatArray
from holdfast.simulation.effect import Effect
from holdfast.simulation.values import Parameter


def pressure(count: int) -> FloatArray:
    """[E] share of the normal force on each of E elements: p ~ 1 - x^2 over the patch; sum 1.

    A soft fingertip presses hardest in the middle (Johnson, "Contact mechanics", 1985, chapter 4),
    so the outer elements reach mu N first: incipient slip. A single element bears everything and
    slips all at once.
    """
    x = (np.arange(count) + 0.5) / count
    share = 1.0 - x * x
    even: FloatArray = share / share.sum()
    return even


BRUSH = Effect(
    "brush",
    "physics",
    make=lambda count: pressure(int(count)),
    parameters={"count": Parameter(5.0, "", 1, 50, "elements of each contact")},
    constant="count",
    sets="pressure",
)
