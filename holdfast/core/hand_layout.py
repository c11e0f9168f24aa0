"""The layout of the hand: how many contacts its thumb and its four fingers have, and where."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import FloatArray

THUMB_MM, FINGER_MM = 48.0, 22.0
"""Widths along the object's axis, contacts spread evenly over each."""
FINGERS_AT_MM = (33.0, 11.0, -11.0, -33.0)
"""Middles of index, middle, ring, little."""


@dataclass(frozen=True)
class HandLayout:
    """Numbers of contacts, the thumb's first, then finger by finger; default: the thesis' hand."""

    thumb: int = 2
    finger: int = 1

    @property
    def n_contacts(self) -> int:
        """S, contacts of the whole hand."""
        return self.thumb + len(FINGERS_AT_MM) * self.finger

    @property
    def part(self) -> FloatArray:
        """[S] a contact's stiffness over that of a contact of the thesis' hand."""
        fingers = np.full(len(FINGERS_AT_MM) * self.finger, 1.0 / self.finger)
        return np.concatenate([np.full(self.thumb, 2.0 / self.thumb), fingers])

    @property
    def along_m(self) -> FloatArray:
        """[S] positions of the contacts along the axis of a cylinder."""
        fingers = [_spread(FINGER_MM, self.finger) + middle for middle in FINGERS_AT_MM]
        return 1e-3 * np.concatenate([_spread(THUMB_MM, self.thumb), *fingers])


def _spread(width_mm: float, count: int) -> FloatArray:
    """[count] middles of equal parts of a width, centred on 0, the uppermost first."""
    places: FloatArray = width_mm * (0.5 - (np.arange(count) + 0.5) / count)
    return places
