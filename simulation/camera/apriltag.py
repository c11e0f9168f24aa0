"""AprilTags of the family 36h11: their black and white cells.

Code words and bit order: Olson, ICRA 2011; AprilRobotics/apriltag, tag36h11.
"""

from __future__ import annotations

from functools import cache

import numpy as np

from holdfast.edge_runtime.contract import FloatArray

CODES = (0xD7E00984B, 0xDDA664CA7)
"""Words of tags 0 and 1, 36 bits each."""
SIDE_CELLS = 8
"""Cells along the side of a tag: six of data and a black border of one; a white margin of one
surrounds it."""
_QUARTER_ROWS, _QUARTER_COLUMNS = [0, 0, 0, 0, 0, 1, 1, 1, 2], [0, 1, 2, 3, 4, 1, 2, 3, 2]
"""Places of the first nine bits in the six by six; each next nine lie a quarter turn clockwise."""


@cache
def cells(tag: int) -> FloatArray:
    """[10, 10] cells of a tag with its margin, 1 white, 0 black, first row on top; read-only."""
    bits = [CODES[tag] >> (35 - k) & 1 for k in range(36)]
    data = np.zeros((6, 6))
    for quarter in range(4):
        np.rot90(data, quarter)[_QUARTER_ROWS, _QUARTER_COLUMNS] = bits[
            9 * quarter : 9 * quarter + 9
        ]
    whole = np.pad(np.pad(data, 1), 1, constant_values=1.0)
    whole.flags.writeable = False
    return whole
