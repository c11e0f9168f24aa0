"""Where the arrows of the fingers stand in a 3D view, and how long they are.

The view is a picture, not the geometry of a hand: two rows of pads face each other, the thumb's and
that of the other fingers, and each arrow points from its pad away from the object.
"""

from __future__ import annotations

from dataclasses import dataclass
from types import MappingProxyType

import numpy as np

from holdfast.edge_runtime.contract import FloatArray, Unit
from holdfast.simulation.hand import HandLayout

HALF_GAP_M = 0.03
"""From the middle of the object to each row."""
ONE_ROW_M = 0.022
"""Between two pads of a hand without six sensors, which are one row."""
METRES_PER_UNIT = MappingProxyType({"N": 1e-2, "uT": 1e-5, "count": 1e-5})
"""Length of an arrow: 1 N is 1 cm long, and so is 1000 uT, about the field of 1 N."""


@dataclass(frozen=True)
class Pads:
    """at_m [S, 3] places; turned [S, 3, 3] from a sensor's axes to those of the view."""

    at_m: FloatArray
    turned: FloatArray


def pads(n_sensors: int) -> Pads:
    """The pads of a hand in the order of its channels (docs/wiring.md)."""
    hand = HandLayout()
    if n_sensors == hand.n_contacts:
        along = hand.along_m
        side = np.where(np.arange(n_sensors) < hand.thumb, -1.0, 1.0)
    else:
        along = ONE_ROW_M * (0.5 * (n_sensors - 1) - np.arange(n_sensors, dtype=np.float64))
        side = np.ones(n_sensors)
    at_m = np.column_stack([along, HALF_GAP_M * side, np.zeros(n_sensors)])
    turned = np.zeros((n_sensors, 3, 3))
    turned[:, 0, 0] = 1.0  # a sensor's X along the row
    turned[:, 1, 2] = side  # its Z, the normal, away from the object
    turned[:, 2, 1] = -side  # its Y completes a right-handed frame
    return Pads(at_m, turned)


def orientations(along: FloatArray) -> FloatArray:
    """[n, 4] quaternions x, y, z, w that turn the x axis to unit vectors [n, 3].

    The half-way quaternion (1 + x . v, x cross v), normalised; opposite to x it turns about z.

    >>> orientations(np.array([[0.0, 0.0, 1.0]])).round(4).tolist()
    [[0.0, -0.7071, 0.0, 0.7071]]
    """
    zero = np.zeros(len(along))
    halfway = np.column_stack([zero, -along[:, 2], along[:, 1], 1.0 + along[:, 0]])
    halfway[np.linalg.norm(halfway, axis=1) < 1e-9] = (0.0, 0.0, 1.0, 0.0)
    unit: FloatArray = halfway / np.linalg.norm(halfway, axis=1, keepdims=True)
    return unit


def arrows(values: FloatArray, unit: Unit, where: Pads) -> tuple[FloatArray, FloatArray]:
    """(length [S] in m, quaternion [S, 4]) of the arrows of a sample, values [C] all finite."""
    vectors = np.einsum("sij,sj->si", where.turned, values.reshape(-1, 3))
    size = np.linalg.norm(vectors, axis=1)
    towards = np.divide(vectors, size[:, None], where=size[:, None] > 0.0, out=_ahead(len(size)))
    return METRES_PER_UNIT[unit] * size, orientations(towards)


def _ahead(count: int) -> FloatArray:
    return np.tile([1.0, 0.0, 0.0], (count, 1))
