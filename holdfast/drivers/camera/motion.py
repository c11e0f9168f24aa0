"""How an object moves in the hand, from the corners of two printed tags in a camera's frames.

One tag is on the object and one on the hand. The object's place is given in the axes of the hand's
tag, in mm of the printed side. So a hand that moves, turns or comes nearer changes nothing. Numpy
only.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from holdfast.core.contract import BoolArray, FloatArray
from holdfast.core.errors import LabelError, TagError

SIGMAS = 5.0
FLOOR_PX = 0.15
REST_S = 0.3
REST_FRAMES = 5
"""An object rests when all frames of this time, and at least this many, stay within the threshold.

The threshold is around their median.
"""
DIFFER = 0.05
"""Tags of one size, in one plane and facing the camera, have sides that differ by less."""


@dataclass(frozen=True)
class Motion:
    """The object in the hand: t_s [K], place_mm [K, 2] (nan where a tag is hidden), and the scale.

    mm_per_px is the scale at the hand's tag.
    """

    t_s: FloatArray
    place_mm: FloatArray
    mm_per_px: float

    @property
    def seen(self) -> int:
        """Frames that show both tags."""
        return len(self._seen_mm)

    @property
    def _seen_mm(self) -> FloatArray:
        return self.place_mm[np.isfinite(self.place_mm).all(axis=1)]

    @property
    def sigma_mm(self) -> float:
        """Noise of one axis, from the median step between frames.

        A slip of a few frames does not change it.
        """
        # 1.4826 makes the median deviation of a normal distribution its sigma
        steps = np.diff(self._seen_mm, axis=0)
        return (
            float(1.4826 * np.median(np.abs(steps)) / np.sqrt(2.0))
            if len(steps)
            else 0.0
        )

    @property
    def threshold_mm(self) -> float:
        """An object that is further from rest than this has moved."""
        return max(SIGMAS * self.sigma_mm, FLOOR_PX * self.mm_per_px)

    def until(self, until_s: float) -> Motion:
        """The part up to until_s."""
        part = self.t_s <= until_s
        return Motion(self.t_s[part], self.place_mm[part], self.mm_per_px)


def motion(
    t_s: FloatArray,
    object_px: FloatArray,
    hand_px: FloatArray,
    tag_mm: float,
) -> Motion:
    """The object's motion in the hand's axes, from the corners of both tags.

    object_px, hand_px: [K, 4, 2] (column, row; clockwise from top left), nan if hidden. tag_mm: the
    printed side without its margin, the same for both tags. Raises TagError where the tags
    contradict each other, LabelError where both tags are never seen together.
    """
    seen = np.isfinite(object_px) & np.isfinite(hand_px)
    both: BoolArray = np.logical_and.reduce(seen, axis=(1, 2))
    if both.sum() < REST_FRAMES:
        raise LabelError(
            f"both tags are seen in {both.sum()} of {len(both)} frames",
            cause="a tag is out of the picture, covered, out of focus or without its white margin",
            next_step="look at the video; use tags 0 (object) and 1 (hand) of the family 36h11",
        )
    _require_one_size(object_px[both], hand_px[both], tag_mm)
    # corners of a square around its centre, as complex numbers: a turn is a product
    square = tag_mm * np.array([-0.5 - 0.5j, 0.5 - 0.5j, 0.5 + 0.5j, -0.5 + 0.5j])
    hand, thing = (
        corners[both, :, 0] + 1j * corners[both, :, 1]
        for corners in (hand_px, object_px)
    )
    about = hand - hand.mean(axis=1, keepdims=True)
    # least squares: the one turn and scale that maps the hand's corners onto its square
    turn = (about.conj() * square).sum(axis=1) / (np.abs(about) ** 2).sum(axis=1)
    place = turn * (thing.mean(axis=1) - hand.mean(axis=1))
    place_mm = np.full((len(t_s), 2), np.nan)
    place_mm[both] = np.stack([place.real, place.imag], axis=1)
    return Motion(t_s, place_mm, float(np.median(np.abs(turn))))


def sides_px(corners_px: FloatArray) -> FloatArray:
    """Median (width, height) of a tag [K, 4, 2] in px."""
    sides = np.linalg.norm(np.roll(corners_px, -1, axis=1) - corners_px, axis=2)
    return np.array([np.median(sides[:, ::2]), np.median(sides[:, 1::2])])


def _require_one_size(
    object_px: FloatArray, hand_px: FloatArray, tag_mm: float
) -> None:
    thing = sides_px(object_px)
    hand = sides_px(hand_px)
    for name, side in (("object", thing), ("hand", hand)):
        if abs(side[0] / side[1] - 1.0) > DIFFER:
            raise TagError(
                f"the {name}'s tag is {side[0]:.1f} px wide and {side[1]:.1f} px high, not square",
                cause="the tag does not face the camera, or the printer scaled it one way",
                next_step="turn the tag to the camera, and measure both sides",
            )

    share = float(thing.mean() / hand.mean())
    if abs(share - 1.0) > DIFFER:
        raise TagError(
            f"if the hand's tag is {tag_mm:g} mm, the object's is {tag_mm * share:.2f} mm",
            cause="the tags have two sizes, or one is nearer to the camera",
            next_step="measure both printed sides, and put both tags in one plane",
        )
