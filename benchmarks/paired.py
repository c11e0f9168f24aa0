"""The interval of a difference between paired outcomes."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
from scipy.stats import binomtest

from holdfast.data.metrics import Interval

EACH = 0.975
"""Two intervals of this level hold together with 95 % (Bonferroni)."""


def paired_change(
    outcomes: Mapping[str, bool], before: Mapping[str, bool]
) -> tuple[float | None, Interval | None]:
    """(share of `outcomes` minus that of `before`, its 95 % interval), over cases of both by key.

    Only cases that changed count: gained minus lost. Each of these shares has an exact interval, so
    the difference is never too narrow, also where nothing changed. None without a case.
    """
    both = [key for key in outcomes if key in before]
    n = len(both)
    if not n:
        return None, None
    now = np.array([outcomes[key] for key in both])
    then = np.array([before[key] for key in both])
    gained = int(np.sum(now & ~then))
    lost = int(np.sum(~now & then))
    more = binomtest(gained, n).proportion_ci(EACH, method="exact")
    less = binomtest(lost, n).proportion_ci(EACH, method="exact")
    low = float(more.low - less.high)
    high = float(more.high - less.low)
    return (gained - lost) / n, (low, high)
