"""The contact rule: when a hand touches something, for sensors at rest and for whole recordings."""

from __future__ import annotations

from types import MappingProxyType

import numpy as np

from holdfast.core.contract import FloatArray, Unit

NORMAL_FLOOR: MappingProxyType[Unit, float] = MappingProxyType(
    {"N": 0.3, "uT": 100.0, "count": 300.0}
)
"""A finger with a smaller normal reading touches nothing; above the noise of a resting channel.

In the stream's unit. No friction ratio is computed below it, and a resting normal below minus this
value means a reversed magnet.
"""

CONTACT_SHARE, CONTACT_SMOOTH_S = 0.1, 0.1
"""A hand is closed on something while its normal force exceeds this share of its 95 % quantile."""


def contact_rows(
    load: FloatArray, rate_hz: float, least: float = 0.0
) -> tuple[int, int] | None:
    """First row with the hand closed on something, and first row after the last such; None without.

    load [T]: sum of the fingers' normal forces without bias; it is averaged over 0.1 s. least: a
    hand whose load never exceeds it has touched nothing.
    """
    rows = max(1, round(CONTACT_SMOOTH_S * rate_hz))
    padded = np.pad(load, (rows // 2, (rows - 1) // 2), mode="symmetric")
    smooth = np.convolve(padded, np.full(rows, 1.0 / rows), mode="valid")
    high = float(np.quantile(smooth, 0.95))
    if high < least:
        return None
    closed = np.flatnonzero(smooth >= CONTACT_SHARE * high)
    return int(closed[0]), int(closed[-1]) + 1
