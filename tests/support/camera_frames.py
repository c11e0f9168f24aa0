"""Frames of a camera that looks along the object's y: x to the right, z upwards, two tags.

A pixel's value is the exact integral, over its area, of the tags seen through a Gaussian lens.
Cells are rectangles along the axes, so the integral is a product of two one-dimensional ones, each
in closed form: a cell's edge at u gives F(u) = u Phi(u) + phi(u), the integral of the normal
distribution. Sub-sampling instead would move a tag by up to 0.1 px. Left out: perspective, tilt,
fingers before the tag, rolling shutter, uneven light. So a tracker's error here is a lower bound.

The tags are AprilTags of the family 36h11. Their code words and bit order are from Olson, ICRA
2011, and AprilRobotics/apriltag, tag36h11.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
import numpy.typing as npt
from scipy.interpolate import CubicSpline
from scipy.special import ndtr

from holdfast.core.contract import FloatArray

Frames = npt.NDArray[np.uint8]
"""Grey levels, 0 to 255: [H, W] one frame, [K, H, W] several."""
CODES = (0xD7E00984B, 0xDDA664CA7)
"""Words of tags 0 and 1, 36 bits each."""
SIDE_CELLS = 8
"""Cells along the side of a tag: six of data and a black border of one; a white margin of one
surrounds it."""
_QUARTER_ROWS = [0, 0, 0, 0, 0, 1, 1, 1, 2]
_QUARTER_COLUMNS = [0, 1, 2, 3, 4, 1, 2, 3, 2]
"""Places of the first nine bits in the six by six; each next nine lie a quarter turn clockwise."""
OBJECT_TAG = 0
HAND_TAG = 1
"""Places in CODES: the tag on the object, and the tag on the hand."""
AWAY_SIDES = 1.0
"""At rest the tag of the object lies one side right of the middle, the hand's one side left."""
BLACK = 30.0
WHITE = 220.0
GREY = 120.0
"""Levels of a tag's cells and of everything behind the tags, of 255."""
FAR_BLURS = 6.0
"""Beyond this many blurs from a tag, less than 1e-9 of it is visible."""
EXPOSED_AT = np.array([0.1, 0.3, 0.5, 0.7, 0.9])
"""Shares of the exposure at which the moving tags are drawn; the frame is their mean."""


@cache
def cells(tag: int) -> FloatArray:
    """[10, 10] cells of a tag with its margin, 1 white, 0 black, first row on top; read-only."""
    # The first bit is the highest of the word.
    code = CODES[tag]
    bits = [code >> (35 - k) & 1 for k in range(36)]

    # rot90 gives a view, so writing to it fills the data
    data = np.zeros((6, 6))
    for quarter in range(4):
        first = 9 * quarter
        turned = np.rot90(data, quarter)
        turned[_QUARTER_ROWS, _QUARTER_COLUMNS] = bits[first : first + 9]

    bordered = np.pad(data, 1)
    whole = np.pad(bordered, 1, constant_values=1.0)
    whole.flags.writeable = False

    return whole


@dataclass(frozen=True)
class Camera:
    """One camera with a global shutter.

    The time stamp is the end of the exposure, as in depthai; tag_mm: the side of a tag, its white
    margin not counted; blur_px: the standard deviation of the lens's blur.
    """

    fps: float = 60.0
    width_px: float = 640.0
    height_px: float = 400.0
    px_per_mm: float = 4.0
    tag_mm: float = 10.0
    exposure_ms: float = 2.0
    blur_px: float = 0.7

    def film(
        self, t_s: FloatArray, object_m: FloatArray, hand_m: FloatArray
    ) -> tuple[FloatArray, Frames]:
        """(time stamps [K] in s, frames [K, H, W]) of a trial.

        object_m: [T, 3] of the object in the hand, hand_m: [T, 3] of the hand, at t_s [T].
        """
        # An exposure that began before the recording would need a motion that is not there.
        first = int(np.ceil(1e-3 * self.exposure_ms * self.fps))
        stamps_s = np.arange(first, int(t_s[-1] * self.fps) + 1) / self.fps
        before_s = 1e-3 * self.exposure_ms * (1.0 - EXPOSED_AT)

        # The physics has few samples a frame; motion between them is smooth.
        places = CubicSpline(t_s, np.hstack([object_m + hand_m, hand_m]))
        frames = []
        for end_s in stamps_s:
            at_mm = 1e3 * places(np.clip(end_s - before_s, t_s[0], t_s[-1]))
            # The camera looks along y and sees (x, z) of the object and of the hand.
            exposed = [self.draw(at[[0, 2]], at[[3, 5]]) for at in at_mm]
            frames.append(np.rint(np.mean(exposed, axis=0)).astype(np.uint8))
        return stamps_s, np.array(frames)

    def draw(self, object_mm: FloatArray, hand_mm: FloatArray) -> FloatArray:
        """[H, W] exact levels at one instant; tags moved by (x, z) mm from rest."""
        image = np.full((int(self.height_px), int(self.width_px)), GREY)
        for tag, moved_mm in ((OBJECT_TAG, object_mm), (HAND_TAG, hand_mm)):
            column_px, row_px = self.centre_px(tag, moved_mm)
            rows, down = self._seen(row_px, self.height_px)
            columns, across = self._seen(column_px, self.width_px)
            # The integral over a pixel is a product of one along each axis.
            levels = BLACK + (WHITE - BLACK) * cells(tag)
            light = down @ levels @ across.T

            # Where a tag covers a pixel in part, the rest of it is grey.
            covered = np.outer(down.sum(axis=1), across.sum(axis=1))
            image[rows, columns] += light - GREY * covered
        return image

    def centre_px(self, tag: int, moved_mm: FloatArray) -> tuple[float, float]:
        """(column, row) of a tag's centre; the first pixel reaches from 0 to 1."""
        side = 1.0 if tag == OBJECT_TAG else -1.0
        away_px = side * AWAY_SIDES * self.tag_mm * self.px_per_mm
        right_px = self.px_per_mm * moved_mm[0]
        up_px = self.px_per_mm * moved_mm[1]

        # Rows of a frame count downwards.
        column_px = 0.5 * self.width_px + away_px + right_px
        row_px = 0.5 * self.height_px - up_px
        return float(column_px), float(row_px)

    def _seen(self, centre_px: float, size_px: float) -> tuple[slice, FloatArray]:
        """(the n pixels a tag reaches along one axis, [n, 10] the share of each in every cell)."""
        # Edges of the ten cells, the margin included.
        cell_px = self.tag_mm * self.px_per_mm / SIDE_CELLS
        # Eight cells and a margin on both sides are ten cells with eleven edges.
        edges = np.arange(SIDE_CELLS + 3) - 0.5 * (SIDE_CELLS + 2)
        edges_px = centre_px + cell_px * edges

        # Pixels beyond the frame are not seen.
        far_px = FAR_BLURS * self.blur_px
        reach_px = edges_px[[0, -1]] + far_px * np.array([-1.0, 1.0])
        # One more at the end, because a slice leaves out its stop.
        ends = np.clip([reach_px[0], reach_px[1] + 1.0], 0, size_px)
        first = int(ends[0])
        stop = int(ends[1])

        # F(u) = u Phi(u) + phi(u), the integral of the normal distribution Phi
        borders_px = np.arange(first, stop + 1)[:, None]
        u = (borders_px - edges_px) / self.blur_px
        density = np.exp(-0.5 * u * u) / np.sqrt(2.0 * np.pi)
        integral_px = self.blur_px * (u * ndtr(u) + density)

        # A pixel's share beyond each edge; between two edges lies a cell.
        beyond_edge = np.diff(integral_px, axis=0)
        in_cell = beyond_edge[:, :-1] - beyond_edge[:, 1:]
        return slice(first, stop), in_cell
