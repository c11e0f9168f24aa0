"""A change without a jerk: how a hand, a person or a shake goes from one place to another."""

from __future__ import annotations

import numpy as np

from holdfast.core.contract import FloatArray


def smooth(u: FloatArray) -> FloatArray:
    """0 below 0, 1 above 1, minimum jerk between (Flash & Hogan, J. Neurosci. 5, 1985)."""
    u = np.minimum(np.maximum(u, 0.0), 1.0)
    # 10 u^3 - 15 u^4 + 6 u^5
    polynomial = 10.0 + u * (6.0 * u - 15.0)
    return u * u * u * polynomial


def smooth_change(u: FloatArray) -> FloatArray:
    """The second derivative of that path by u, for u from 0 to 1."""
    return u * (60.0 - u * (180.0 - 120.0 * u))
