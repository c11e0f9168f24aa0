"""The hand that a card asks for: on how many places its thumb and its four fingers feel.

    [hand]
    thumb = 4                # contacts on the thumb, 2 unless said
    finger = 4               # contacts on each of the four fingers, 1 unless said: 20 with the thumb's

A finger's contacts share it: each has an equal part of the finger's stiffness, and of the object's
under it, so that a finger on more places is no stiffer finger. Along a cylinder they stand side by
side over the finger's width. All press along the thumb's axis: there is no palm, and a finger does
not bend between its contacts.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from edge_runtime.contract import FloatArray
from simulation.values import Parameter

HAND = {
    "thumb": Parameter(2.0, "", 2, 20, "contacts on the thumb"),
    "finger": Parameter(1.0, "", 1, 20, "contacts on each of the four fingers"),
}
THUMB_MM, FINGER_MM = 48.0, 22.0
"""Widths along the object's axis, contacts spread evenly over each."""
FINGERS_AT_MM = (33.0, 11.0, -11.0, -33.0)
"""Middles of index, middle, ring, little."""


@dataclass(frozen=True)
class Hand:
    """Numbers of contacts: those of the thumb come first, then finger by finger. The default is the
    thesis' hand."""

    thumb: int = 2
    finger: int = 1

    @property
    def n_contacts(self) -> int:
        """S, of the whole hand."""
        return self.thumb + len(FINGERS_AT_MM) * self.finger

    @property
    def part(self) -> FloatArray:
        """[S] a contact's stiffness over that of one contact of the thesis' hand."""
        fingers = np.full(len(FINGERS_AT_MM) * self.finger, 1.0 / self.finger)
        return np.concatenate([np.full(self.thumb, 2.0 / self.thumb), fingers])

    @property
    def along_m(self) -> FloatArray:
        """[S] where the contacts stand along the axis of a cylinder."""
        fingers = [_spread(FINGER_MM, self.finger) + middle for middle in FINGERS_AT_MM]
        return 1e-3 * np.concatenate([_spread(THUMB_MM, self.thumb), *fingers])


def _spread(width_mm: float, count: int) -> FloatArray:
    """[count] middles of as many equal parts of a width about 0, the upper first."""
    places: FloatArray = width_mm * (0.5 - (np.arange(count) + 0.5) / count)
    return places
